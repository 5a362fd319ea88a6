"""Fleets: many logs, each a job in its own process; finished jobs are skipped; tables over all logs."""
