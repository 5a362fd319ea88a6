"""A log: the topics of all its files, adapted to known types, as streams of columns on one clock."""
