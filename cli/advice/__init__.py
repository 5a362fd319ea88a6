"""The evaluator: from a measured and fused log to findings whose fixes were tried. No click, no print."""
