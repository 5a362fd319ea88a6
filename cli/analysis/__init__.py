"""From a log to its report: topics chosen, load, configurations, compare, outputs, gates. No click, no print."""
