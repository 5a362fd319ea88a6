"""Wheel motion: reading and repairing wheels, exact arcs, noise, calibration; motion by scans without wheels."""
