"""Inner loops as plain functions of numbers and flat arrays: one source, interpreted or compiled ahead of time."""
