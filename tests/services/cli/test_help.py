"""Help that fits a terminal of 80 columns, and what the shell completes."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.cli.bench import KERNELS
from cogradar.services.topology import SERVICES

COMMANDS = [command.name or command.callback.__name__ for command in app.registered_commands if command.callback]


@pytest.mark.parametrize("command", ["", *COMMANDS, "bench", "bench kernels", "bench dwell", "bench feed"])
def test_help_fits_eighty_columns_whole(command: str) -> None:
    done = CliRunner().invoke(app, [*command.split(), "--help"], env={"COLUMNS": "80"}, prog_name="cogradar")
    assert done.exit_code == 0
    assert max(map(len, done.output.splitlines())) <= 80
    assert "…" not in done.output


def test_help_names_every_role_whole() -> None:
    shown = CliRunner().invoke(app, ["service", "--help"], env={"COLUMNS": "80"}).output
    assert set(SERVICES) <= set(re.findall(r"[a-z]+", shown))


def _completed(words: str) -> list[str]:
    """What bash is offered for the last word."""
    environment = {"_COGRADAR_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = CliRunner().invoke(app, [], env=environment, prog_name="cogradar")
    return done.output.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("cogradar sc", ["scenarios", "schema"]),
        ("cogradar run pa", ["paper", "paper-best", "paper-best-range", "paper-literal"]),
        ("cogradar run smoke --strategy o", ["orthogonal"]),
        ("cogradar campaign smoke --strategies uniform,o", ["uniform,orthogonal"]),
        ("cogradar query p", ["p_d", "picture"]),
        ("cogradar service al", ["allocator"]),
        ("cogradar bench kernels allocate_1", ["allocate_10", "allocate_100"]),
    ],
)
def test_names_are_completed(words: str, offered: list[str]) -> None:
    assert _completed(words) == offered


def test_all_names_are_offered_for_nothing() -> None:
    assert _completed("cogradar query ") == [
        "runs",
        "tracks",
        "p_d",
        "rmse",
        "consistency",
        "confirmation",
        "summary",
        "picture",
        "antennas",
        "commands",
    ]
    assert set(_completed("cogradar bench kernels ")) == set(KERNELS)


def test_files_are_completed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old").mkdir()
    for name in ("mine.toml", "mine.db", "old/runs.db", "old/note.txt"):
        (tmp_path / name).touch()
    assert _completed("cogradar check mi") == ["mine.toml"]
    assert _completed("cogradar report ") == ["mine.db", "old/"]
    assert _completed("cogradar query p_d --store old/") == ["old/runs.db"]
    assert _completed(f"cogradar figures {tmp_path}/m") == [f"{tmp_path}/mine.db"]


def test_completion_is_installed_for_the_users_shell(tmp_path: Path) -> None:
    """The shell is the process that calls."""
    command = f"{Path(sys.executable).with_name('cogradar')} --install-completion; true"
    environment = os.environ | {"HOME": str(tmp_path)}
    done = subprocess.run(["bash", "-c", command], env=environment, capture_output=True, text=True, check=True)
    assert "bash completion installed" in done.stdout, done.stderr
    assert "_COGRADAR_COMPLETE" in (tmp_path / ".bash_completions" / "cogradar.sh").read_text()
