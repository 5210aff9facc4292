"""The texts that people read get no harder to read: counts of what makes a sentence hard, with limits that only fall.

The limits are what is left in the texts. A change that adds to a count fails; one that reduces it lowers the limit.
`python -m tests.docs.test_words` lists what is left.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.docs.documents import PAGES, REPOSITORY

LONGEST = 35  # words of a sentence
COUNTED = {
    "who, whoever": re.compile(r"\bwho(?:ever)?\b", re.IGNORECASE),
    "nobody": re.compile(r"\bnobody\b", re.IGNORECASE),
    "that of, those of": re.compile(r"\b(?:that|those) of\b", re.IGNORECASE),
}
# People are "who". A rule, a key, a scenario and a view have their names; the last ones are not "the one of".
EXCEPTIONS = re.compile(
    r"\b(?:people|person|users?|readers|researchers|engineers|developers|operators|anybody|somebody|someone|those|authors?)"
    r"(?:[^.;:]{0,40}?,)? who\b"
    r"|\bwho (?:asked|commanded|knows? the truth|wrote)\b"  # of a command: a person's name
    r"|`who`|`nobody`|\bnobody\.toml\b|\bsweep nobody\b|\"nobody\"|'nobody'"
    r"|\b(?:so|say|said|says|told|know|knows|aware|sure|means|is|all|think) that of\b",
    re.IGNORECASE,
)
SQL = re.compile(r"\bSELECT\b|\bCREATE TABLE\b|\bCOALESCE\b")
ITEM = re.compile(r"\n\s*\n|\n(?=\s*[\w.,* ()]{1,40} : )")  # "name : text" is an item of a list
ROOTS = ("cogradar", "services", "shared", "studies", "docs", "deploy")

# What is left. Lower a number when you lower the count.
LIMITS = {
    "pages": {"long sentences": 3, "who, whoever": 0, "nobody": 0, "that of, those of": 0},
    "program": {"long sentences": 0, "who, whoever": 3, "nobody": 0, "that of, those of": 0},
}


def paragraphs(page: str) -> Iterator[str]:
    """The prose of a Markdown page: paragraphs, items and cells, without code and what commands write."""
    page = re.sub(r"^```.*?^```$", "", page, flags=re.DOTALL | re.MULTILINE)
    page = re.sub(r"^<!-- (\w[^>]*) -->\n.*?^<!-- /\1 -->$", "", page, flags=re.DOTALL | re.MULTILINE)
    page = re.sub(r"^\$\$.*?\$\$", "", page, flags=re.DOTALL | re.MULTILINE)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*|#]|\d+\.) )|\n(?=\|)", page):
        if block.startswith("|"):
            yield from re.split(r"(?<!\\)\|", block.strip().strip("|"))
        else:
            yield block


def sentences(text: str) -> Iterator[str]:
    """Sentences of a paragraph. A link counts as its text, a formula or code as one word."""
    text = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"\$[^$]+\$|`[^`]+`", "X", text)
    yield from re.split(r"(?<=[.!?:])\s+(?=[\"'(*_]*[A-Z0-9])|\n\s*\n", " ".join(text.split()))


def prose(text: str) -> str:
    """A text without formulas and examples: paragraphs that are indented further than the others."""
    indents = [len(line) - len(line.lstrip()) for line in text.splitlines()[1:] if line.strip()]
    formula = " " * (min(indents, default=0) + 4)
    blocks = re.split(r"\n[ \t]*\n", text)
    return "\n\n".join(block for block in blocks if not all(line.startswith(formula) for line in block.splitlines()))


def texts_of(source: str) -> Iterator[str]:
    """Docstrings, other texts and comments of a program, without SQL and indented formulas.

    Each item of a list of names or symbols is a text. Adjacent lines of comments are one, a comment behind code is one.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and not SQL.search(node.value):
            for text in ITEM.split(prose(node.value)):
                yield from text.split(";") if "Symbols:" in text else [text]
    comment: list[str] = []
    last = -1  # line of the comment before, if nothing else is on it
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            is_alone = not token.line[: token.start[1]].strip()
            if not is_alone or token.start[0] != last + 1:
                yield " ".join(comment)
                comment = []
            comment.append(token.string.lstrip("# "))
            last = token.start[0] if is_alone else -1
    yield " ".join(comment)


def found(texts: Iterator[tuple[str, str]]) -> dict[str, list[str]]:
    """What each count finds in pairs of a place and a text, as lines to be read."""
    faults: dict[str, list[str]] = {"long sentences": [], **{name: [] for name in COUNTED}}
    for place, text in texts:
        for sentence in sentences(text):
            if len(sentence.split()) > LONGEST:
                faults["long sentences"].append(f"{place}: {sentence}")
        plain = EXCEPTIONS.sub("", " ".join(text.split()))
        for name, pattern in COUNTED.items():
            faults[name] += [
                f"{place}: ...{plain[max(0, hit.start() - 40) : hit.end() + 40]}..." for hit in pattern.finditer(plain)
            ]
    return faults


def of_pages() -> Iterator[tuple[str, str]]:
    """Place and text of every paragraph of the documents."""
    for page in [*PAGES, *REPOSITORY.glob("[A-Z]*.md")]:
        if page.name not in {"CHANGELOG.md"}:
            for text in paragraphs(page.read_text(encoding="utf-8")):
                yield str(page.relative_to(REPOSITORY)), text


def of_program() -> Iterator[tuple[str, str]]:
    """Place and text of every docstring, message and comment."""
    files = [path for root in ROOTS for path in sorted((REPOSITORY / root).rglob("*.py"), key=Path.as_posix)]
    for path in files:
        if not path.parent.is_symlink():
            for text in texts_of(path.read_text(encoding="utf-8")):
                yield str(path.relative_to(REPOSITORY)), text


@pytest.mark.parametrize(("what", "texts"), [("pages", of_pages), ("program", of_program)])
def test_the_texts_get_no_harder_to_read(what: str, texts: Callable[[], Iterator[tuple[str, str]]]) -> None:
    faults = found(texts())
    more = {name: hits for name, hits in faults.items() if len(hits) > LIMITS[what][name]}
    assert {name: len(hits) for name, hits in more.items()} == {}


def test_a_hard_sentence_is_counted() -> None:
    long = "A " + "very " * LONGEST + "long sentence."
    text = f"{long} Whoever reads it is lost, and nobody finds the power that of all is least."
    counts = found(iter([("here", text)]))
    assert {name: len(hits) for name, hits in counts.items()} == {
        "long sentences": 1,
        "who, whoever": 1,
        "nobody": 1,
        "that of, those of": 1,
    }
    fine = found(iter([("here", "People who read `nobody` know that of two runs one is shorter.")]))
    assert not any(fine.values())
    assert list(paragraphs("A b.\n\n```sh\nwho\n```\n| c | d |\n")) == ["A b.", " c ", " d "]


def test_comments_of_fields_formulas_and_items_are_no_sentences() -> None:
    source = '''"""A text.

        f = g

x : an item
y : one more
"""

a = 1  # one
b = 2  # two
# three
# goes on
'''
    assert [text.strip() for text in texts_of(source) if text] == [
        "A text.",
        "x : an item",
        "y : one more",
        "one",
        "two",
        "three goes on",
    ]


if __name__ == "__main__":  # python -m tests.docs.test_words: every fault that is left
    for of in (of_pages, of_program):
        for name, hits in found(of()).items():
            sys.stdout.write("\n".join([f"== {of.__name__}, {name}: {len(hits)}", *hits, ""]))
