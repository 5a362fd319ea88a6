"""Results of many logs: one row each (CSV, Parquet), and one page over all of them."""
