"""Stretches of a drive that the compiled core takes at once, without the loop of `fuse`."""
