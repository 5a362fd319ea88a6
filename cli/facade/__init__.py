"""locfuse: what does each sensor buy my robot? EKF localization from recorded logs."""
