"""One file per sensor: its settings (its TOML table), its measurements, and its model in the filter."""
