"""`locfuse export ros`: what was found about a robot as parameters of ROS nodes, each with its reason."""
