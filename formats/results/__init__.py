"""Results as files for other tools: trajectories, audit trail, MCAP."""
