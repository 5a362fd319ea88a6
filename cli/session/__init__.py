"""A measured log and what it gives: run, compare, and a summary over several logs. No click, no print."""
