"""From logs and results to Rerun scenes, and the viewer."""
