"""The command line: python -m cogradar."""

import sys


def main() -> None:
    """Run a command. An interrupt ends it as one, also while all that a command needs is loaded: for half a second."""
    try:
        from cogradar.services.cli.app import main as run
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
