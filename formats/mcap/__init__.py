"""MCAP files: reading whole and damaged ones, writing."""
