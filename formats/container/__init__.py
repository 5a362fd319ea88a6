"""Files of recorded logs: bytes in, batches of raw messages out; .mcap has its own room."""
