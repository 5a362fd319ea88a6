"""The commands, one file each; `compare` has three more: one log, many logs, finished results."""
