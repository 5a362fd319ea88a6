"""Judging estimates: deviation from truth, consistency, the effect of each sensor. No filter runs here."""
