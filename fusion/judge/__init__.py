"""Judging estimates: deviation from truth, consistency, what each sensor adds. Nothing here fuses."""
