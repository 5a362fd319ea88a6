"""Choosing topics: which topic feeds the wheels, each sensor and the truth."""
