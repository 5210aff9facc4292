"""The page of promises has the newest commands, and what they name is there."""

import re
from pathlib import Path

import pytest
from typer.main import get_command

from cogradar.services.cli.app import app
from docs.generator.reliability import END, NOT_YET, PAGE, PROOFS, Proof, last_line, page
from studies.__main__ import app as studies

ROOT = Path(__file__).parents[2]


def test_the_page_has_a_row_of_each_promise() -> None:
    """Else: make reliability."""
    text = PAGE.read_text(encoding="utf-8")
    assert page(text, {}) == text
    assert len({proof.part for proof in PROOFS}) == len(PROOFS)


@pytest.mark.parametrize("proof", PROOFS, ids=lambda proof: proof.part)
def test_what_a_command_names_is_there(proof: Proof) -> None:
    program, first = proof.command.split()[:2]
    if program == "pytest":
        named = re.findall(r"tests/\S+", proof.command)
        assert named
        assert all((ROOT / name.partition("::")[0]).exists() for name in named)
    elif program == "python" and (module := proof.command.split()[2]).startswith("tests."):
        assert (ROOT / module.replace(".", "/")).with_suffix(".py").exists()
    elif program == "python":
        assert proof.command.startswith("python -m studies ")
        assert proof.command.split()[3] in get_command(studies).commands  # type: ignore[attr-defined]
    else:
        assert program == "cogradar"
        assert first in get_command(app).commands  # type: ignore[attr-defined]


def test_a_new_result_replaces_its_own_row_alone() -> None:
    text = page(PAGE.read_text(encoding="utf-8"), {PROOFS[0].part: "1 failed"})
    again = page(text, {PROOFS[1].part: "2 failed"})
    rows = [line for line in again.partition(END)[0].splitlines() if line.startswith("| ")][1:]
    assert "| 1 failed |" in rows[0]
    assert "| 2 failed |" in rows[1]
    assert len(rows) == len(PROOFS)
    assert NOT_YET in page("<!-- proofs --><!-- /proofs -->", {})


def test_a_result_is_the_last_line_without_its_frame() -> None:
    assert last_line("...\n==== 3 passed, 1 skipped in 61.20s (0:01:01) ====\n") == "3 passed, 1 skipped"
    assert last_line("a\n20 runs, 7 processes killed, 0 runs differ\n") == "20 runs, 7 processes killed, 0 runs differ"
