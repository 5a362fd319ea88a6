"""Scans as points with surfaces, matched with each other (point to line)."""
