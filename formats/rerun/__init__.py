"""Rerun recordings: a scene as values, and how it is drawn, saved and sent."""
