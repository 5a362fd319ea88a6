"""The world we can know exactly: the simulated robot, its scenarios, and the logs it recorded."""
