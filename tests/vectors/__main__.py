"""Test vectors of the wire: `python -m tests.vectors` compares the file with the program, `--write` writes it."""

import sys

from tests.vectors.cases import FILE, lines

if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        FILE.write_text(lines(), encoding="utf-8")
    elif FILE.read_text(encoding="utf-8") != lines():
        sys.exit(f"{FILE} is stale: python -m tests.vectors --write")
