"""Test vectors of the wire, and programs of other languages.

`python -m tests.vectors` compares the file of vectors with the program, `--write` writes it. `--journal FILE` lets the
reader in C++ read all messages of a stored run, compares what it writes back, and prints its rate.
"""

import argparse
import sqlite3
import sys
import tempfile
from contextlib import closing
from pathlib import Path

from tests.vectors import foreign
from tests.vectors.cases import FILE, lines


def _recorded(journal: str) -> None:
    opened = sqlite3.connect(f"file:{journal}?mode=ro", uri=True)
    with closing(opened) as store, tempfile.TemporaryDirectory() as folder:
        if foreign.MISSING:
            sys.exit(foreign.MISSING)
        payloads = [row[0] for row in store.execute("SELECT payload FROM message")]
        n, different, numbers, seconds = foreign.counted(foreign.compiled(Path(folder)), payloads)
    size = sum(map(len, payloads))
    sys.stdout.write(
        f"{n} messages, {size / 1e6:.1f} MB, {numbers} numbers in arrays: {different} differ;"
        f" {n / seconds:,.0f} messages and {size / seconds / 1e6:.0f} MB a second\n"
    )
    sys.exit(different > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.vectors", description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--journal", metavar="FILE")
    asked = parser.parse_args()
    if asked.journal:
        _recorded(asked.journal)
    if asked.write:
        FILE.write_text(lines(), encoding="utf-8")
    elif FILE.read_text(encoding="utf-8") != lines():
        sys.exit(f"{FILE} is stale: python -m tests.vectors --write")
