"""Checks: what the sensors of a drive say of each other, and whether a fix helps. Nothing here fuses."""
