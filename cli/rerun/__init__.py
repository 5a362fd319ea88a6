"""Rerun: scenes from logs and results, and the viewer."""
