"""Results of many logs: a row per log (CSV, Parquet), and one HTML page over all."""
