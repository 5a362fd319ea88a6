"""A log: topics over all its files, adapted to the types that are read, as streams of columns on one clock."""
