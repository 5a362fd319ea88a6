"""Many logs: one job each in its own process, finished ones are not repeated, one table over all."""
