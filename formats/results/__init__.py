"""Results for other tools: trajectories and audit trail as text, estimates and recovered logs as MCAP."""
