"""`python -m locfuse.cli`."""

from .main import main

main()
