"""`locfuse export ros`: a robot's figures as parameters of ROS nodes, each with its reason."""
