"""The site is built without a warning, from the program that it describes, and needs nobody else to be read."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from cogradar.services.cli.app import app
from cogradar.services.cli.manual.examples import COMMANDS
from cogradar.shared.protocol.topics import TOPICS
from cogradar.shared.wire.exposition import METRICS
from docs.generator.sphinx_extension import PART, PARTS, as_markdown, generated
from tests.docs.documents import PAGES, REPOSITORY


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` makes it."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", "--jobs", "auto"]
    done = subprocess.run([*command, REPOSITORY / "docs", folder], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return folder


@pytest.mark.slow
def test_every_page_is_there_and_asks_no_other_host(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert {page.relative_to(site).with_suffix(".md") for page in pages} >= {
        page.relative_to(REPOSITORY / "docs") for page in PAGES if page.name != "README.md"
    }
    for page in pages:
        loaded = _Loaded()
        loaded.feed(page.read_text(encoding="utf-8"))
        assert [url for url in loaded.urls if re.match(r"(\w+:)?//", url)] == [], page
    styles = " ".join(path.read_text(encoding="utf-8") for path in site.rglob("*.css"))
    assert re.findall(r"url\(['\"]?(?:https?:)?//[^)]*", styles) == []


@pytest.mark.slow
def test_formulas_are_mathematics_and_not_text(site: Path) -> None:
    text = (site / "explanation" / "model.html").read_text(encoding="utf-8")
    assert text.count("<math") > 30
    assert "\\frac" not in text
    assert "$" not in re.sub(r"<(script|math).*?</\1>", "", text, flags=re.DOTALL)


class _Loaded(HTMLParser):
    """What a browser fetches to show a page: not what a reader may follow."""

    def __init__(self) -> None:
        super().__init__()
        self.urls: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the addresses of scripts, styles and pictures."""
        given = dict(attrs)
        if tag in {"script", "img", "iframe", "link"} and given.get("rel") != "canonical":
            self.urls += [url for name in ("src", "href") if (url := given.get(name))]


def test_a_list_of_pages_calls_them_by_their_titles() -> None:
    listed = [
        (title, page.parent / name)
        for page in PAGES
        if page.name == "index.md"
        for title, name in re.findall(
            r"^- \[([^]]+)\]\(([\w./-]+\.md)\)", page.read_text(encoding="utf-8"), re.MULTILINE
        )
    ]
    assert len(listed) > 20
    for title, page in listed:
        text = page.read_text(encoding="utf-8")
        (included,) = re.findall(r"^```{include} (\S+)", text, re.MULTILINE) or [""]
        whole = (page.parent / included).read_text(encoding="utf-8") if included else text
        assert f"# {title}\n" in whole, page


def test_all_parts_are_used_and_none_is_empty() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(PART.findall(text)) == PARTS.keys()
    assert "<!-- generated" not in text  # nothing is seen of it in a clone, where an empty section follows
    for name, part in PARTS.items():
        assert len(part()) > 20, name
    with pytest.raises(KeyError):
        generated("*Generated: nothing. `make docs` fills it in.*")


def test_the_reference_has_what_the_program_has() -> None:
    messages, metrics, commands = (PARTS[name]() for name in ("messages", "metrics", "commands"))
    assert all(f"### {topic.message.__name__}\n" in messages for topic in TOPICS)
    assert all(f"`cogradar_{name}" in metrics for name in METRICS)
    names = [*COMMANDS, *(command.name for command in app.registered_commands)]
    assert all(f"### cogradar {name}\n" in commands for name in names)
    keys = PARTS["scenario keys"]()
    assert "| `p_fa` | number | 1e-09 to 0.1 |" in keys
    assert "| `filter` | one of `likelihood`, `published`, `gaussian`, or [your own]" in keys
    assert "| km/s² | as the radar assumes |" in keys
    assert "| `tracks` | whole number or `unknown` | 1 to 1000 |" in keys
    assert "| `share` | number or `auto` | above 0 to below 1 | `auto` |" in keys
    assert "None" not in keys
    assert "| `snr_db` | real | dB |" in PARTS["store"]()


def test_a_notebook_is_its_texts_and_its_code() -> None:
    page = as_markdown(
        '{"cells": [{"cell_type": "markdown", "source": ["# A\\n", "b"]}, {"cell_type": "code", "source": ["1"]}]}'
    )
    assert page == "# A\nb\n\n```python\n1\n```"
