"""The diagram of the loop is the table of topics, and the documents hold the newest."""

import re
from pathlib import Path

import pytest

from cogradar.shared.protocol.topics import TOPICS
from docs.generator.loop_diagram import diagram, rewritten

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("page", ["ARCHITECTURE.md", "docs/reference/wire.md"])
def test_a_page_has_the_newest_diagram(page: str) -> None:
    """Else: make diagram."""
    text = (ROOT / page).read_text(encoding="utf-8")
    assert diagram() in text
    assert rewritten(text) == text


def test_its_arrows_are_the_table() -> None:
    arrows = re.findall(r"^  (\w+) [-=]+>\|\"([^\"]+)\"\| (\w+)$", diagram(), re.MULTILINE)
    drawn = {(sender, word, reader) for sender, words, reader in arrows for word in words.split(", ")}
    assert len(drawn) == sum(len(topic.readers) for topic in TOPICS)
    assert {(sender, reader) for sender, _, reader in drawn} == {
        (str(topic.producer), str(reader)) for topic in TOPICS for reader in topic.readers
    }
