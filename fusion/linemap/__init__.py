"""The line map: (rho, beta) of walls, data association, map upkeep, slip and kidnapping."""
