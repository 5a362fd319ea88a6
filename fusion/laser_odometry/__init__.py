"""Laser odometry: the motion of a robot without wheels, by matching scans with scans."""
