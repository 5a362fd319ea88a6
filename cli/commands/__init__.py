"""The commands of `locfuse`; a file is imported when one of its commands is used."""
