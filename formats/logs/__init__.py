"""Logs: the topics of all files of a log, converted to known message types, as streams with one clock."""
