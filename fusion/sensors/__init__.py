"""One file per sensor: its settings (its TOML table), how it measures, how the filter sees it."""
