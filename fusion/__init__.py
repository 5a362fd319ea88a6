"""Numbers in, numbers out: no files, no screens, no commands."""
