"""Files on robot and map: robot.toml, ROS parameters, /tf_static, URDF, line and landmark maps, map images."""
