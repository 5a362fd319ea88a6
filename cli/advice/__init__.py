"""Advice: from a measured and fused log to findings with tried fixes. No click, no print."""
