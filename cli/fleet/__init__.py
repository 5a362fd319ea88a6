"""Many logs: a job each in a process of its own, finished ones are not run again, one table over all."""
