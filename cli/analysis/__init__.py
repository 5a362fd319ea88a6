"""From a log to its report: topics chosen, load, configurations, compare, gates. No click, no print."""
