"""Files of recorded logs (MCAP, .db3, .bag; here, in a bucket or on a web server): bytes <-> raw messages."""
