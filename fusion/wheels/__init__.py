"""Wheel odometry: reading and repair of wheel data, motion model, noise, calibration; scan-matched odometry."""
