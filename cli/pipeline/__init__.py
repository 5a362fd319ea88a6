"""From a log to its report: load, configurations, compare, outputs. No click, no print."""
