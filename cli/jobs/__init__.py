"""Jobs on top of the pipeline: CI gates, calibration, tuning, the control loop's estimator."""
