"""The command line: python -m cogradar."""

from cogradar.services.cli.app import main

main()
