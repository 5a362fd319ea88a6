"""The commands, one file each; `compare` has one more, for finished results."""
