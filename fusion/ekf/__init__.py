"""The extended Kalman filter: the belief and its operations, the map frame, and the record of a run."""
