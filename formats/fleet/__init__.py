"""Results of many logs: one row each for machines (CSV, Parquet), and one page over all of them for people."""
