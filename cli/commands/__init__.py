"""The commands of `locfuse`, one file each."""
