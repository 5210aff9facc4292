"""The command line: python -m cogradar."""

from services.cli.app import main

main()
