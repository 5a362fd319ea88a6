"""What the terminal shows and takes: shared options, tables, notes, progress."""
