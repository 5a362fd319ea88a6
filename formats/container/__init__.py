"""Reading log files (MCAP, .db3, .bag; local or remote) as raw messages, and writing MCAP."""
