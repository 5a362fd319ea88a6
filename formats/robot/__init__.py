"""The robot's description in files: robot.toml, /tf_static, URDF, a saved line map."""
