"""`locfuse export ros`: estimated settings of a robot as parameters of ROS nodes, each with its source."""
