"""Measurements of locfuse: accuracy over simulated and recorded drives, speed relative to public packages."""
