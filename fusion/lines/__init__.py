"""Extraction of straight walls from laser scans, as lines (r, psi) with covariance."""
