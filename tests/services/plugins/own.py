"""Runs with a user's own things, and what is done to these."""

import threading
from pathlib import Path
from typing import Any

from cogradar.services.runs.run import strategy_of
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.plugins import resolver, sources

NOBODY: dict[str, Any] = {"report": lambda _: None, "notify": lambda _: None, "stop": threading.Event()}


def forget() -> None:
    """Be a process that was told nothing."""
    sources._allowed.places.clear()
    resolver._found.clear()


def start_of(folder: Path, *settings: str, dwells: int = 12, run: str = "r") -> RunStart:
    """A run with all of them."""
    own = [
        f"radar.planner.rule={folder}/rule.py:ahead",
        f"radar.belief.filter={folder}/belief.py:Bootstrap",
        f"world.disturbance.model={folder}/disturbance.py:BURSTS",
        *settings,
    ]
    strategy = strategy_of(f"{folder}/strategy.py:strongest")
    return RunStart.of(load("smoke", own), strategy, 1, dwells).model_copy(update={"run": run})


def failing(folder: Path, file: str, name: str, body: str) -> str:
    """A file with a function that does something else."""
    (folder / file).write_text(f"def {name}(*_):\n    {body}\n", encoding="utf-8")
    return f"{folder / file}:{name}"


def with_other_sources(folder: Path) -> Path:
    """The same folder, with other sources."""
    for file in folder.glob("*.py"):
        file.write_text(file.read_text() + "\n# changed later\n")
    return folder
