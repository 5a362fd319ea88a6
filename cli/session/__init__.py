"""The Python API: a measured log and its results; the bodies of `calibrate`, `tune`, `paper`, `simulate`."""
