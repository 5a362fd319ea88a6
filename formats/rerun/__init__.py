"""Rerun recordings: a scene as values, and its drawing, saving and streaming."""
