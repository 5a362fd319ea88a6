"""Noise settings from logs: maximum likelihood on recorded runs of the filter."""
