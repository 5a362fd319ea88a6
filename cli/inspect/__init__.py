"""Inspection of a log for `info` and `init`: topics, mounts, clocks, findings, a draft of robot.toml."""
