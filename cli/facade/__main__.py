"""Run the command line by `python -m locfuse`."""

from locfuse.cli.main import main

main()
