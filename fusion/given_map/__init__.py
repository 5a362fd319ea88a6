"""A map that others drew: the walls of an occupancy grid as lines, and where in it a drive began."""
