"""Words the user types: one file per command; the one place that prints, and the one error border."""
