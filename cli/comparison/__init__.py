"""What `locfuse compare` does: with one log, with many, with finished results."""
