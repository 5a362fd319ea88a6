"""The log doctor: what the sensors of a drive say of each other before any filter runs."""
