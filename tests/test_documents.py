"""The documents keep up with the program."""

import ast
import re
import warnings
from collections import Counter
from pathlib import Path

import pytest

from cogradar.services.analysis.pages import WIDEST
from docs.generator import readme

REPOSITORY = Path(__file__).resolve().parents[1]
ARCHITECTURE = (REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8")
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")

LONG = 400  # lines of a file
ENTRIES = {"__init__.py", "__main__.py"}  # not modules that a reader chooses among


def test_the_code_map_names_every_folder_and_no_other() -> None:
    table = ARCHITECTURE.partition("## Code map")[2].partition("\n## ")[0]
    rooms = {path.parent for package in ("shared", "services") for path in (REPOSITORY / package).glob("*/*.py")}
    assert set(re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE)) == {
        *(str(room.relative_to(REPOSITORY)) for room in rooms),
        "cogradar",
    }


def test_every_file_that_the_architecture_names_is_there() -> None:
    named = re.findall(r"`((?:shared|services)/[^`]+\.py)`", ARCHITECTURE)
    assert len(named) > 20
    assert [name for name in named if not (REPOSITORY / name).exists()] == []


def test_every_folder_says_what_lives_there_and_what_never_does() -> None:
    for package in ("shared", "services"):
        for room in (REPOSITORY / package).glob("*/__init__.py"):
            text = ast.get_docstring(ast.parse(room.read_text(encoding="utf-8"))) or ""
            assert len(text.splitlines()) in {2, 3, 4}, room
            assert "ever here" in text, room


@pytest.mark.filterwarnings("default::UserWarning")
def test_rooms_are_not_crowded() -> None:
    """Some ten modules in a folder, six beside the folders. A file of more than 400 lines is a warning, no failure."""
    for package in ("shared", "services", "cogradar"):
        files = [path for path in (REPOSITORY / package).rglob("*.py") if path.name not in ENTRIES]
        crowds = Counter(path.parent.relative_to(REPOSITORY) for path in files)
        assert crowds[Path(package)] <= {"shared": 0, "services": 6, "cogradar": 6}[package]
        assert max(crowds.values()) <= 11
        for path in files:
            if (n := len(path.read_text(encoding="utf-8").splitlines())) > LONG:
                warnings.warn(f"{path.relative_to(REPOSITORY)} has {n} lines, more than {LONG}", stacklevel=1)


def test_architecture_is_short_enough_to_be_read() -> None:
    assert len(ARCHITECTURE.splitlines()) <= 150


def test_the_readme_is_short_enough_to_be_read() -> None:
    assert len(README.splitlines()) < 100


def test_the_figures_of_the_readme_are_on_the_page_that_it_names() -> None:
    facts = README.partition("## What was measured")[2].partition("\nThe weakest")[0].split("\n- ")[1:]
    assert len(facts) == 5
    for fact in facts:
        (page,) = re.findall(r"\]\((docs/[^)#]+)\)", fact)
        text = (REPOSITORY / page).read_text(encoding="utf-8").replace("[", "").replace("]", "").replace(",", "")
        said = re.findall(r"\d*\.\d{2,}|\d{3,}", re.sub(r"(\d) (\d{3})\b", r"\1\2", fact.partition("](")[0]))
        rounded = {"0.01"}  # of what the search buys: tests/docs/test_figures.py
        assert [number for number in said if number not in text.replace(" 000", "000") and number not in rounded] == []


def test_the_table_of_the_readme_is_as_its_command_writes_it() -> None:
    assert readme.with_results(README) == README, "python -m docs.generator.readme"


def test_no_table_of_results_is_wider_than_seven_columns_and_no_file_is_left_over() -> None:
    pages = sorted((REPOSITORY / "docs").glob("*.md"))
    for page in pages:
        rows = re.findall(r"^\| .*", page.read_text(encoding="utf-8"), re.MULTILINE)
        assert [row for row in rows if row.count(" | ") >= WIDEST and "](" not in row] == [], page
    linked = {name for page in pages for name in re.findall(r"\((tables/[^)]+)\)", page.read_text(encoding="utf-8"))}
    assert linked == {f"tables/{file.name}" for file in (REPOSITORY / "docs" / "tables").iterdir()}


def test_every_file_that_a_document_links_to_is_there() -> None:
    documents = [*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md")]
    links = [
        (d, link)
        for d in documents
        for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", d.read_text(encoding="utf-8"))
    ]
    assert len(links) > 5
    assert [(d.name, link) for d, link in links if not (d.parent / link).exists()] == []
