"""Run the command line by `python -m locfuse.cli`."""

from .main import main

main()
