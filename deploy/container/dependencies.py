"""Print the lock's entries, hashes included, of what is wanted: python dependencies.py requirements.lock wanted.txt."""

import re
import sys
from pathlib import Path

lock, wanted = (Path(name).read_text(encoding="utf-8") for name in sys.argv[1:3])
entries = {entry.split()[0]: entry for entry in re.split(r"\n(?=\S)", lock)}  # "numpy==2.4.6": it and its hashes
chosen = [line.split()[0] for line in wanted.splitlines()]
if missing := [name for name in chosen if name not in entries]:
    sys.exit(f"{sys.argv[1]} lacks {', '.join(missing)}: make lock")
sys.stdout.write("\n".join(entries[name] for name in chosen))
