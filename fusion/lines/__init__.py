"""Straight walls in laser scans: split, merge, fit, in (r, psi) with covariance. No pose needed."""
