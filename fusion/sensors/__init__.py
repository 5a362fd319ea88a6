"""Sensors: one file each, with its settings (its table in robot.toml), its measurements and its filter model."""
