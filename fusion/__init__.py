"""Estimation from arrays of sensor readings to arrays of results; reads no files, prints nothing."""
