"""What `info` and `init` find in a log: topics, mounts, clocks, findings, a first robot.toml."""
