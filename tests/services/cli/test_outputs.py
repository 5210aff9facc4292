"""Names of files and folders that a command is to write: what cannot be is refused before any work, by its option."""

import os
from pathlib import Path

import pytest

from cogradar.services.analysis.export.whole import made, whole
from cogradar.services.errors import BadInput
from tests.services.cli.here import here

FILES = (
    ("export", "--format", "csv", "--force", "--out"),
    ("schema", "--out"),
    ("sky", "--out"),
    ("chaos", "--pace", "realtime", "--out"),
    ("sweep", "smoke", "--over", "radar.array.n_tx=8,16", "--store", "s.db", "--into"),
    ("report", "s.db", "--into"),
    ("simulate", "--store"),
    ("new", "rule"),
)
FOLDERS = (
    ("figures", "s.db", "--out"),
    ("sweep", "smoke", "--over", "radar.array.n_tx=8,16", "--store", "s.db", "--out"),
    ("certs", "init", "--folder"),
    ("feed", "--to", "geojson", "--store", "s.db", "--out"),
)


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a folder and a file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.toml").mkdir()
    (tmp_path / "file").touch()
    (tmp_path / "gone").symlink_to("nowhere")


TOO_LONG = 60 * "long."


@pytest.mark.parametrize("command", FILES, ids=" ".join)
@pytest.mark.parametrize("name", ["", "there.toml", "nowhere/x.toml", "gone", TOO_LONG])
def test_a_file_that_cannot_be_written_is_refused_with_the_cure(command: tuple[str, ...], name: str) -> None:
    _is_refused(command, name)


@pytest.mark.parametrize("command", FOLDERS, ids=" ".join)
@pytest.mark.parametrize("name", ["", "file", "file/x", "gone", TOO_LONG])
def test_a_folder_that_cannot_be_is_refused_with_the_cure(command: tuple[str, ...], name: str) -> None:
    _is_refused(command, name)


def _is_refused(command: tuple[str, ...], name: str) -> None:
    done = here(*command, name)
    option = command[-1] if command[-1].startswith("--") else "FILE"
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(option)
    assert name.partition("/")[0][:60] in done.stderr
    assert "name a" in " ".join(done.stderr.split()) or "make it first" in done.stderr
    assert sorted(path.name for path in Path().rglob("*")) == ["file", "gone", "there.toml"]


def test_a_name_with_a_slash_at_its_end_is_of_a_folder() -> None:
    _is_refused(("export", "--format", "csv", "--out"), "x.csv/")


def test_a_page_that_is_not_there_is_refused_before_the_runs() -> None:
    done = here("sweep", "smoke", "--over", "radar.array.n_tx=8,16", "--store", "s.db", "--into", "none.md")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("--into: none.md: there is no such file: name a page")
    assert not Path("s.db").exists()


def test_in_python_the_same_are_refused(tmp_path: Path) -> None:
    os.mkfifo("pipe")
    for name in ("", "there.toml", "/", "nowhere/x.csv", "gone", "pipe", TOO_LONG):
        with pytest.raises(BadInput), whole(Path(name), force=True):
            pass
    with pytest.raises(BadInput, match="is a file"):
        made(tmp_path / "file")
    made(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
