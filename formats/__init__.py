"""Bytes <-> values: MCAP, message decoding, robot.toml, trajectories, reports, Rerun."""
