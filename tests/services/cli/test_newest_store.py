"""Commands that are not told a store take the newest one of build/, and say so."""

import os
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.cli import console
from cogradar.services.cli.app import app
from cogradar.services.errors import NoMetrics
from cogradar.services.metrics import client
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from tests.services.loop import smoke_start


@pytest.fixture
def build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an older and a newer store, neither of which is one."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "build"
    folder.mkdir()
    for age_s, name in enumerate(("new.db", "old.db", "newest.txt")):
        (folder / name).touch()
        os.utime(folder / name, (1e9 - age_s, 1e9 - age_s))
    return folder


def test_the_newest_store_is_the_one_written_last(build: Path) -> None:
    assert console.newest_store() == "build/new.db"
    for path in build.glob("*.db"):
        path.unlink()
    assert console.newest_store() is None


@pytest.mark.parametrize("command", ["report", "figures"])
def test_report_and_figures_say_which_store_they_take(build: Path, command: str) -> None:
    done = CliRunner().invoke(app, [command])
    assert "build/new.db: the newest store in build/" in done.stderr
    assert done.exit_code == 2  # it is none
    for path in build.glob("*.db"):
        path.unlink()
    assert "no STORE, and no *.db in build/: name one" in CliRunner().invoke(app, [command]).stderr


def test_query_asks_the_newest_store_only_if_no_service_answers(build: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert build.is_dir()
    asked: list[object] = []

    def ask(*given: object) -> None:
        asked.append(given[0])
        raise NoMetrics("no metrics service")

    monkeypatch.setattr(client, "ask_service", ask)
    monkeypatch.setattr(client, "answer", lambda *given: [{"metric": given[1]}])
    monkeypatch.setattr(client, "Journal", lambda path, **_: path)
    monkeypatch.setattr(client, "Store", _Opened)
    for connect in (console.DEFAULT_ENDPOINT, "tcp/elsewhere:1"):
        with client.source(None, connect, partial(console.newest_instead, connect)) as ask_any:
            if connect == console.DEFAULT_ENDPOINT:
                assert [ask_any("runs", {}), ask_any("tracks", {})] == [[{"metric": "runs"}], [{"metric": "tracks"}]]
            else:
                with pytest.raises(NoMetrics):
                    ask_any("runs", {})
    assert asked == [console.DEFAULT_ENDPOINT, "tcp/elsewhere:1"]


def test_a_service_that_has_answered_is_not_left_for_a_store(build: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or one file would be of two sources."""
    assert build.is_dir()
    answers = iter([[{"n": 1}]])

    def ask(*_: object) -> object:
        try:
            return next(answers)
        except StopIteration:
            raise NoMetrics("no metrics service") from None

    monkeypatch.setattr(client, "ask_service", ask)
    connect = console.DEFAULT_ENDPOINT
    with client.source(None, connect, partial(console.newest_instead, connect)) as ask_any:
        assert ask_any("runs", {}) == [{"n": 1}]
        with pytest.raises(NoMetrics):
            ask_any("runs", {})


@pytest.mark.parametrize("command", [["replay", "--to", "planner"], ["export", "--what", "tracks", "--out", "a.csv"]])
def test_replay_and_export_take_the_newest_store_too(
    build: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    def silent(*_: object) -> None:
        raise NoMetrics("no metrics service")

    monkeypatch.setattr(client, "ask_service", silent)
    with closing(Store(Journal(str(build / "made.db"), owner="x"))) as store:
        in_process.play(smoke_start(dwells=3), store=store)
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert " ".join(done.stderr.split()).startswith("build/made.db: the newest store in build/; no service answers at ")
    done = CliRunner().invoke(app, [*command, "other"])
    assert (done.exit_code, "asked was build/made.db" in done.stderr) == (2, True)


def test_a_run_that_the_newest_store_has_not_is_refused_with_the_store_and_the_option(
    build: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent(*_: object) -> None:
        raise NoMetrics("no metrics service")

    monkeypatch.setattr(client, "ask_service", silent)
    with closing(Journal(str(build / "made.db"), owner="x")) as journal:
        journal.add_run(smoke_start())
    for asked in (["--run", "nobody"], ["--scenario", "nothing"]):
        done = CliRunner().invoke(app, ["query", "p_d", *asked])
        assert done.exit_code == 2
        assert done.stderr.strip().endswith("; asked was build/made.db: --store FILE names another store")
        done = CliRunner().invoke(app, ["query", "p_d", *asked, "--store", "build/made.db"])
        assert (done.exit_code, done.stderr.strip().endswith("; asked was build/made.db")) == (2, True)
    done = CliRunner().invoke(app, ["query", "p_d", "--target", "9"])
    assert (done.exit_code, "asked was" in done.stderr) == (2, False)


def test_an_answer_without_rows_says_why(build: Path) -> None:
    file = str(build / "made.db")
    with closing(Journal(file, owner="x")) as journal:
        journal.add_run(smoke_start())
    for metric, why in (("confirmation", 'radar.tracks = "unknown"'), ("commands", "no command was given")):
        done = CliRunner().invoke(app, ["query", metric, "--store", file])
        assert (done.exit_code, done.stdout.splitlines()[0]) == (0, "no rows")
        assert why in done.stdout


class _Opened:
    def __init__(self, path: str) -> None:
        self.path = path

    def close(self) -> None:
        """Nothing is open."""
