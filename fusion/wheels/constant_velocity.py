"""Constant velocity: what the scans say of the motion, filtered, so that it goes on where they say nothing.

The state is the body's velocity (forward, left, turn), which goes on and is slowly forgotten (Singer's model:
Bar-Shalom, Li and Kirubarajan 2001, 8.2.3). A pair of scans dt apart says of v dt the twist m with an
information H, which is singular along a corridor and zero where nothing matches: there the velocity before is the
best guess. In information form the update needs no inverse of H:

    P^-1 <- P^-1 + dt^2 H,    P^-1 v <- P^-1 v + dt H m

A velocity that nothing corrects is wrong by the same for seconds: its errors add up, and do not average out. From
one pair to the next the error goes on as A = P_after P_before^-1 times what is kept, so that over many pairs it
spreads as independent steps of covariance dt^2 (P + M + M') do, with M = (1 - A)^-1 A P.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array

USUAL = np.array([0.5, 0.3, 1.0]) ** 2  # (m/s)^2, (m/s)^2, (rad/s)^2: of a robot of which nothing is known
FORGOTTEN_S = np.array([4.0, 4.0, 1.0])  # s after which a velocity says little: turns change fastest


def inverse(P: Array) -> Array:
    """Return the inverse of matrices (..., n, n)."""
    return np.asarray(np.linalg.inv(P), np.float64)


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
        prior = inverse(self.P)
        P = inverse(prior + dt * dt * information)
        return Velocity(P @ (prior @ self.v + dt * (information @ twist)), 0.5 * (P + P.T))

    def spread(self, before: Velocity, dt: float) -> Array:
        """Return the covariance (3, 3) of a step of dt [s] at this velocity, which was expected to be `before`."""
        if dt == 0.0:  # two scans of one stamp: no time to move, and A is 1
            return np.zeros((3, 3))
        A = self.P @ inverse(before.P) * np.exp(-dt / FORGOTTEN_S)
        M = np.linalg.solve(np.eye(3) - A, A @ self.P)
        values, vectors = np.linalg.eigh(dt * dt * (self.P + M + M.T))
        out: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return out


def standing() -> Velocity:
    """Return what is known before the first scan: a recording is started before the robot is."""
    return Velocity(np.zeros(3), 0.25 * np.diag(USUAL))
