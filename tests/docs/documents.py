"""The documents as a reader uses them: their blocks of code, and the commands in these."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]
_FENCE = re.compile(r"(?:^<!-- ([\w: .-]+) -->\n)?^```([\w{}-]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_ENDS = {"&&", "||", "|", ";"}


class Block(NamedTuple):
    """Fenced code."""

    mark: str  # what a comment before it asks of the tests: "run", "run nightly", "file: NAME"; "" if nothing
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page."""
    return [Block(*found) for found in _FENCE.findall(page.read_text(encoding="utf-8"))]


def commands(page: Path) -> Iterator[list[str]]:
    """The commands of a page's shell blocks, as words, without what is assigned before them and redirected."""
    for block in blocks(page):
        if block.language == "sh":
            for line in re.sub(r"\\\n\s*", "", block.text).splitlines():
                yield from _split(re.sub(r"(^|\s+)#\s.*$", "", line))


def said(page: Path) -> Iterator[list[str]]:
    """Commands of ours in the running text: whole ones, with at least one argument."""
    text = _FENCE.sub("", page.read_text(encoding="utf-8"))
    for found in re.findall(r"(?<!`)`((?:cogradar [a-z]+ |make )[^`]+)`(?!`)", text):
        if "..." not in found:
            yield from _split(" ".join(found.split()))


def _split(line: str) -> Iterator[list[str]]:
    words = shlex.shlex(line, posix=True, punctuation_chars="&|;<>")
    words.whitespace_split, words.commenters = True, ""
    command: list[str] = []
    is_file = False
    for word in [*words, ";"]:
        if word in _ENDS:
            while command and re.match(r"\w+=", command[0]):
                command.pop(0)
            if command:
                yield command
            command = []
        elif word == ">":
            is_file = True
        elif is_file:
            is_file = False
        else:
            command.append(word)
