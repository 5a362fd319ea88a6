"""The extended Kalman filter: beliefs (pose, pose and few states, arrays), innovation rows, journal."""
