"""The extended Kalman filter: the belief with all its verbs, the map frame, and the events of a run."""
