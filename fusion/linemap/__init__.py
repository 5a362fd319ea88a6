"""The line map: (rho, beta) of walls, data association and map upkeep."""
