"""The documents keep up with the program."""

import re
from pathlib import Path

from typer.main import get_command

from services.cli.app import app

REPOSITORY = Path(__file__).resolve().parents[1]
ARCHITECTURE = (REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8")
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def _code_map() -> set[str]:
    """Files of the code map; a name without a folder is in that of the name before it."""
    table = ARCHITECTURE.partition("## Code map")[2].partition("\n## ")[0]
    files, folder = set(), Path()
    for name in re.findall(r"`([^`]+\.py)`", table):
        folder = Path(name).parent if "/" in name else folder
        files.add(str(folder / Path(name).name))
    return files


def test_the_code_map_names_every_module_and_no_other() -> None:
    sources = {
        str(path.relative_to(REPOSITORY))
        for package in ("shared", "services")
        for path in (REPOSITORY / package).rglob("*.py")
        if path.name != "__init__.py"
    }
    assert _code_map() == sources


def test_architecture_is_short_enough_to_be_read() -> None:
    assert len(ARCHITECTURE.splitlines()) <= 150


def test_the_readme_shows_every_command() -> None:
    commands = get_command(app).commands  # type: ignore[attr-defined]
    assert [name for name in commands if not re.search(rf"bin/cogradar {name}\s", README)] == []


def test_every_file_that_a_document_links_to_is_there() -> None:
    documents = [*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md")]
    links = [(d, link) for d in documents for link in re.findall(r"\]\(([^)#:]+)\)", d.read_text(encoding="utf-8"))]
    assert len(links) > 5
    assert [(d.name, link) for d, link in links if not (d.parent / link).exists()] == []
