"""Message definitions for bags that carry none, written down by their fields."""
