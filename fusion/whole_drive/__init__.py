"""Whole-drive estimation: the smoother, the pose graph with loop closures, and reference trajectories."""
