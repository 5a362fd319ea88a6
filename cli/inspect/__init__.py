"""The contents of a log for `info` and `init`: topics, mounts, clocks, findings, a first robot.toml."""
