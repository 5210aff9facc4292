"""The command line: python -m cogradar."""

import gc
import sys

# From one search for unreachable ones to the next: neither a program that is loaded nor a message of many parts is a
# reason for some.
NEW_OBJECTS = 20_000


def main() -> None:
    """Run a command. An interrupt ends it as one, also while all that a command needs is loaded: for half a second."""
    gc.set_threshold(NEW_OBJECTS)
    try:
        from cogradar.services.cli.app import main as run
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
