"""Constant velocity: what the scans say of the motion, filtered, so that it goes on where they say nothing.

The state is the body's velocity (forward, left, turn), which goes on and is slowly forgotten (Singer's model:
Bar-Shalom, Li and Kirubarajan 2001, 8.2.3). A pair of scans dt apart says of v dt the twist m with an
information H, which is singular along a corridor and zero where nothing matches: there the velocity before is the
best guess. In information form the update needs no inverse of H:

    P^-1 <- P^-1 + dt^2 H,    P^-1 v <- P^-1 v + dt H m
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array

USUAL = np.array([0.7, 0.3, 1.0]) ** 2  # (m/s)^2, (m/s)^2, (rad/s)^2: of a robot of which nothing is known
FORGOTTEN_S = np.array([30.0, 10.0, 1.0])  # s after which a velocity says little: turns change fastest


class Velocity(NamedTuple):
    """A velocity (3,) [m/s, m/s, rad/s] with its covariance (3, 3)."""

    v: Array
    P: Array

    def after(self, dt: float) -> Velocity:
        """Return what is known of the velocity dt [s] later."""
        kept = np.exp(-dt / FORGOTTEN_S)
        return Velocity(kept * self.v, self.P * np.outer(kept, kept) + np.diag((1.0 - kept**2) * USUAL))

    def corrected(self, dt: float, twist: Array, information: Array) -> Velocity:
        """Return what a motion (3,) over dt [s] with this information (3, 3) leaves of it."""
        prior = np.linalg.inv(self.P)
        P = np.linalg.inv(prior + dt * dt * information)
        return Velocity(P @ (prior @ self.v + dt * (information @ twist)), 0.5 * (P + P.T))


def standing() -> Velocity:
    """Return what is known before the first scan: a recording is started before the robot is."""
    return Velocity(np.zeros(3), 0.25 * np.diag(USUAL))
