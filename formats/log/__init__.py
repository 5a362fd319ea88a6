"""A log: topics over all its files, delivered as streams of columns on one clock."""
