"""Extended Kalman filter: the belief and its operations, the map frame, events, and the record of a run."""
