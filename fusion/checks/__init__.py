"""Checks: compare the sensors of a drive with each other, and test whether a fix helps. No filter runs here."""
