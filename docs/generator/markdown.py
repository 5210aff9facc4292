"""Tables as Markdown has them."""

import re
from collections.abc import Iterable, Sequence


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; columns in which no row says anything are left out."""
    filled = [list(row) for row in rows]
    kept = [i for i in range(len(headings)) if any(row[i] for row in filled)]
    lines = [[headings[i] for i in kept], ["---"] * len(kept), *([_cell(row[i]) for i in kept] for row in filled)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def code(text: object) -> str:
    """A word of the program; nothing of nothing."""
    return f"`{text}`" if str(text) else ""


def prose(text: str) -> str:
    """Plain text of the program, in which no character means anything to Markdown."""
    parts = re.split(r"(`[^`]+`)", " ".join(text.split()))
    return "".join(part if part.startswith("`") else re.sub(r"([\\*_<>\[\]$#~])", r"\\\1", part) for part in parts)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
