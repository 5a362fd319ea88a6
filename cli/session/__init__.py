"""The Python API: a measured log and what it gives; and what `calibrate`, `tune`, `paper`, `simulate` do."""
