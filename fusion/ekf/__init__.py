"""The extended Kalman filter: the belief with all its verbs, the map frame, and what is recorded of a run."""
