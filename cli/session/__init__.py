"""The Python API: sessions (measured logs), results, and the work of `calibrate`, `tune`, `paper`, `simulate`."""
