"""Wheel motion: reading and repairing wheel data, exact arcs, wheel geometry and noise."""
