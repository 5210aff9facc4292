"""A folder with a user's own things, and a process that may load nothing yet."""

import shutil
from pathlib import Path

import pytest

from cogradar.shared.scenario.plugins import resolver, sources

TEMPLATES = Path("deploy/plugins").resolve()


@pytest.fixture(autouse=True)
def _allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test allows this process to load is forgotten after it."""
    monkeypatch.setattr(sources, "_allowed", sources._Allowed())
    monkeypatch.setattr(resolver, "_found", {})
    monkeypatch.delenv(sources.VARIABLE, raising=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one thing of each kind."""
    return shutil.copytree(TEMPLATES, tmp_path / "own", ignore=shutil.ignore_patterns("__pycache__"))
