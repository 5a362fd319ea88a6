"""The terminal: shared options, tables, notes, progress."""
