"""A laser whose mount is uncertain: its lines as the estimated mount puts them into the base, and what that costs.

A line (r, psi) in the base frame follows from the laser's own one and the mount (x, y, yaw) by psi = psi_L + yaw,
r = r_L + x cos(psi) + y sin(psi). So what is predicted for the laser's reading depends on the mount by

    d(r, psi)/d(x, y, yaw) = [[-cos(psi), -sin(psi), x sin(psi) - y cos(psi)], [0, 0, -1]]

at the measured psi, in which this is exact. (At the predicted one the wheels' error in heading would enter, which
goes with their error in distance: y came out wrong by k / (2 dtheta), 8 mm.) Derivatives by pose and line stay.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.core import places
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose
from locfuse.fusion.lines.extract import of_rows, rows_in_base
from locfuse.fusion.lines.sweep import in_base
from locfuse.fusion.mount import Mount


class Seat(NamedTuple):
    """The estimated mount under which a scan's lines were put into the base, and where it lies in the state."""

    x: float  # m
    y: float
    columns: tuple[int, ...]  # (f,) state columns of what is uncertain
    free: tuple[int, ...]  # which of x, y, yaw they are

    def derivative(self, psi: Array) -> Array:
        """Return by how much predicted lines at psi (k,) [rad, base frame] depend on the states, (k, 2, f)."""
        out = np.zeros((len(psi), 2, 3))
        c, s = np.cos(psi), np.sin(psi)
        out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = -c, -s, self.x * s - self.y * c
        out[:, 1, 2] = -1.0
        chosen: Array = out[:, :, list(self.free)]
        return chosen


def seated(rows: Array, mount: Mount, belief: JointBelief) -> tuple[Array, Array, Array, Seat, Array]:
    """Return lines (k, 7), put into the base by the mount as told, as the estimated mount puts them.

    As z, R, ends, seat and the table again.
    """
    now = mount.now(belief)
    table = rows_in_base(rows, *_moved(mount, now).tolist())
    return *of_rows(table), Seat(now[0], now[1], mount.columns(belief), mount.free), table


def seated_shares(shared: Array, z: Array, mount: Mount, belief: JointBelief) -> Array:
    """Return what lines z (k, 2), put into the base by the mount as told, share (k, 2, s), moved as `seated` does.

    Left as it was it would be more than there is of R, and R of the scan no covariance.
    """
    return in_base(shared, z, _moved(mount, mount.now(belief)))


def _moved(mount: Mount, now: Pose) -> Array:
    """Return what leads from the base by the mount as told to the one that is estimated now, (3,) m, m, rad."""
    out = np.empty(3)
    Room.here(places).on_arrays.moved(np.array(now), np.array(mount.told), out)
    return out
