"""Tuning of noise settings: finds those with the maximum likelihood of recorded filter runs."""
