"""Measuring the product: accuracy over simulated drives, speed as ratios against public packages."""
