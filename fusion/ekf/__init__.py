"""The extended Kalman filter: beliefs (pose, pose with a few states, arrays), innovation rows, the journal of a run."""
