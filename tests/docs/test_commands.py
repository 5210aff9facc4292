"""What the documents tell a reader to type is understood, and what takes less than a minute is done."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from scipy.io import loadmat
from typer.main import get_command

from cogradar.services.cli.app import app
from cogradar.services.cli.manual.examples import COMMANDS
from cogradar.services.web.openapi import describe
from tests.docs.documents import PAGES, REPOSITORY, blocks, commands, said

GROUP: Any = get_command(app)


def _targets(folder: str) -> set[str]:
    makefile = (REPOSITORY / folder / "Makefile").read_text(encoding="utf-8")
    return set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))


TARGETS = {"": _targets(""), "studies": _targets("studies")}  # by folder
OTHERS = {
    "cp",
    "dask",
    "datamodel-codegen",
    "docker",
    "export",
    "kubectl",
    "prometheus",
    "python",
    "sed",
    "source",
    "systemctl",
    "systemd-sysusers",
}


def _named(page: Path) -> str:
    return str(page.relative_to(REPOSITORY))


@pytest.mark.parametrize("page", PAGES, ids=_named)
def test_every_command_of_a_page_is_understood(page: Path) -> None:
    for command in commands(page):
        _understood(command)
    for head, name, *rest in said(page):  # part of a command, as often as not
        if head == "make":
            _understood([head, name, *rest])
        else:
            known = {option for one in GROUP.commands[name].params for option in (*one.opts, *one.secondary_opts)}
            assert {word for word in rest if word.startswith("--")} <= known, (name, rest)


def test_the_check_finds_what_is_wrong() -> None:
    _understood(["cogradar", "run", "paper", "--seed", "7"])
    for wrong in (
        ["cogradar", "walk"],
        ["cogradar", "run", "paper", "--speed", "7"],
        ["cogradar", "run", "paper", "--seed", "x"],
        ["make", "coffee"],
        ["curl", "http://localhost:8080/api/v1/run"],
        ["curl", "http://localhost:8080/api/v1/runs?colour=red"],
        ["rm", "-rf", "/"],
        ["docker", "compose", "run", "--rm", "cli", "walk"],
    ):
        with pytest.raises(Exception):  # noqa: B017, PT011 - of many kinds
            _understood(wrong)


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_example_of_the_help_is_understood(name: str) -> None:
    for example in COMMANDS[name].examples:
        words = shlex.split(example)
        assert words[0] == name
        assert len(f"cogradar {example}") < 80
        _understood(["cogradar", *words])


def test_every_command_has_a_panel_and_an_example() -> None:
    assert COMMANDS.keys() == GROUP.commands.keys()
    assert all(shown.examples for shown in COMMANDS.values())
    assert len({shown.panel for shown in COMMANDS.values()}) == 5


def test_commands_are_in_shell_blocks() -> None:
    """Else the test above would not see them."""
    ours = re.compile(r"^(\.venv/bin/)?(cogradar|make|curl|docker|kubectl) ", re.MULTILINE)
    assert [
        (_named(page), block.text)
        for page in PAGES
        for block in blocks(page)
        if block.language in {"", "bash"} and ours.search(block.text)
    ] == []
    assert sum(1 for page in PAGES for _ in commands(page)) > 80


def test_every_command_is_shown_in_a_how_to() -> None:
    shown = {words[1] for page in PAGES for words in commands(page) if words[0] == "cogradar"}
    assert set(GROUP.commands) <= shown


@pytest.mark.parametrize("page", PAGES, ids=_named)
def test_python_of_a_page_is_python(page: Path) -> None:
    for block in blocks(page):
        if block.language == "python":
            compile(block.text, _named(page), "exec")


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [p for p in PAGES if p.stem != "query" and any(b.mark == "run" for b in blocks(p))], ids=_named
)
def test_a_page_does_what_it_says(page: Path, tmp_path: Path) -> None:
    _do(page, {"run"}, tmp_path)


@pytest.mark.slow
def test_what_matlab_is_told_to_read_is_in_the_file(tmp_path: Path) -> None:
    page = REPOSITORY / "docs/howto/query.md"
    _do(page, {"run"}, tmp_path)
    (program,) = (block.text for block in blocks(page) if block.language == "matlab")
    assert set(re.findall(r"\brun\.(\w+)", program)) <= {"mat", *loadmat(tmp_path / "run.mat")}


@pytest.mark.nightly
@pytest.mark.parametrize("page", [p for p in PAGES if any(b.mark == "run nightly" for b in blocks(p))], ids=_named)
def test_a_page_does_what_takes_longer(page: Path, tmp_path: Path) -> None:
    _do(page, {"run", "run nightly"}, tmp_path)


def _do(page: Path, marks: set[str], folder: Path) -> None:
    """All blocks with these marks one after the other, in one folder, as somebody who types them."""
    programs = folder / "bin"
    programs.mkdir()
    (programs / "cogradar").write_text(f'#!/bin/sh\nexec {sys.executable} -m cogradar "$@"\n', encoding="utf-8")
    (programs / "cogradar").chmod(0o755)
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": str(REPOSITORY)}
    for block in blocks(page):
        if block.mark.startswith("file: "):
            (folder / block.mark.removeprefix("file: ")).write_text(block.text, encoding="utf-8")
        elif block.mark in marks:
            program = [sys.executable, "-c"] if block.language == "python" else ["sh", "-ec"]
            done = subprocess.run(
                [*program, block.text],
                cwd=folder,
                env=environment,
                capture_output=True,
                text=True,
                timeout=300,
                check=False,
            )
            assert done.returncode == 0, f"{block.text}\n{done.stdout}\n{done.stderr}"


def _understood(command: list[str]) -> None:
    """Raise for a command that does not exist, or not in this form."""
    head, *rest = command
    match head:
        case "cogradar" | ".venv/bin/cogradar":
            _parsed(rest)
        case "make":
            folder, targets = (rest[1], rest[2:]) if rest[0] == "-C" else ("", rest)
            assert {word for word in targets if "=" not in word} <= TARGETS[folder], command
        case "curl":
            _answered(next(word for word in rest if word.startswith("http")))
        case "docker" if rest[:2] == ["compose", "run"]:
            _parsed(rest[rest.index("cli") + 1 :])
        case "kubectl" if "--" in rest:
            assert rest[rest.index("--") + 1] == "cogradar"
            _parsed(rest[rest.index("--") + 2 :])
        case _:
            assert head in OTHERS, command


def _parsed(arguments: list[str]) -> None:
    name, *rest = arguments
    if name.startswith("--"):
        assert name in {option for parameter in GROUP.params for option in parameter.opts}, name
    else:
        GROUP.commands[name].make_context(f"cogradar {name}", rest)


def _answered(url: str) -> None:
    asked = urlsplit(url)
    for path, methods in describe()["paths"].items():
        if re.fullmatch(re.sub(r"\\\{\w+\\\}", "[^/]+", re.escape(path)), asked.path):
            known = {parameter["name"] for parameter in methods["get"]["parameters"]}
            assert set(parse_qs(asked.query)) <= known, url
            return
    raise AssertionError(f"{url}: no such path")
