"""Evaluation of estimates: errors against truth, consistency, effect of each sensor. No filter runs here."""
