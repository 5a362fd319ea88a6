"""Logs in buckets and on web servers: only the bytes that are wanted, checked to be of one state of the object."""
