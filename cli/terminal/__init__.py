"""The terminal: shared options of commands, tables, notes, progress."""
