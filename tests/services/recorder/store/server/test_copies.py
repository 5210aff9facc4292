"""What a store on a server has in common with a file: the same runs, scores and campaigns, and copies both ways."""

import hashlib
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.campaigns.campaign import results_digest
from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import METRICS, answer
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.copy import _add, copy
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import Command
from cogradar.shared.protocol.orders import PowerLimit
from tests.postgresql import Server
from tests.services.loop import smoke_start

START = smoke_start(dwells=20)


def test_a_run_has_the_same_digest_and_scores_bit_for_bit(postgresql: Server) -> None:
    url, alone = postgresql.url(), in_process.play(START)
    with closing(Store(Journal(url))) as store:
        played = in_process.play(START, store=store)
    assert (played.run["digest"], played.targets, played.picture) == (
        alone.run["digest"],
        alone.targets,
        alone.picture,
    )
    with closing(Store(Journal(url, read_only=True))) as reader:
        assert answer(reader, "summary", {})[0]["run"] == "r"
        assert reader.journal.n_byte() > 0


def test_what_a_campaign_has_kept_is_answered_the_same(postgresql: Server, tmp_path: Path) -> None:
    played = in_memory()
    in_process.play(START, store=played)
    recording = take(played, "r")
    assert recording is not None
    found = []
    filters: list[dict[str, str]] = [
        {},
        {"strategy": START.strategy},
        {"seed": str(START.seed)},
        {"scenario": START.scenario["name"]},
    ]
    for name in (str(tmp_path / "c.db"), postgresql.url()):
        with closing(Journal(name)) as journal:
            journal.add_recording(recording, 7)
            journal.add_recording(recording, 8)  # it is there
        with closing(Store(Journal(name, read_only=True))) as store:
            answers = [answer(store, metric, {"run": "all"} | asked) for metric in METRICS for asked in filters]
            found.append((answers, results_digest(store), store.read("SELECT place FROM run")))
    assert found[0] == found[1]
    assert found[0][2] == [{"place": 7}]


def test_stores_are_copied_both_ways_and_only_into_empty_ones(postgresql: Server, tmp_path: Path) -> None:
    file, url, back = str(tmp_path / "a.db"), postgresql.url(), str(tmp_path / "b.db")
    with closing(Store(Journal(file))) as store:
        digest = in_process.play(START, store=store).run["digest"]
        store.journal.set_campaign({"a": "\u00e4"})
    assert copy(file, url) == copy(url, back)
    tables = ("run", "message", "snapshot", "command", "leader", "campaign")
    contents = []
    for name in (file, url, back):
        with closing(Journal(name, read_only=True)) as journal:
            contents.append(
                [[tuple(row) for row in journal.rows(" ".join(["SELECT * FROM", table]))] for table in tables]
            )
    assert sorted(contents[1][1]) == contents[0][1] == contents[2][1]
    assert [c[0] for c in contents] == [contents[0][0]] * 3
    assert digest in contents[0][0][0]
    done = CliRunner().invoke(app, ["store", "copy", file, url])
    assert (done.exit_code, "has rows: copy to a new file or an empty schema" in done.output) == (2, True)


@pytest.mark.parametrize("table", ["run", "command"])
def test_a_text_that_no_server_can_hold_is_refused_and_named(postgresql: Server, tmp_path: Path, table: str) -> None:
    file, url = str(tmp_path / "a.db"), postgresql.url()
    with closing(Journal(file)) as journal:
        journal.add_run(START)
        action = PowerLimit(share=0.5)
        journal.add_command(
            Command(run="r", id="0" * 32, by="me", action=action, at=0), 1, None, "no\0" * (table != "run")
        )
        journal.hinder("r", "late\0" * (table == "run"))
    with pytest.raises(BadInput, match=rf"run 'r', table {table}, column reason: a text with U\+0000"):
        copy(file, url)
    with closing(Journal(url)) as journal:
        assert journal.start("r") is None
    copy(file, str(tmp_path / "b.db"))


def test_values_of_a_row_are_told_apart() -> None:
    rows = [(1, 23), (12, 3), (b"1", 23), ("1", 23), (None, 123)]
    digests = [hashlib.sha256() for _ in rows]
    for digest, row in zip(digests, rows, strict=True):
        _add(digest, [row])
    assert len({digest.digest() for digest in digests}) == len(rows)


def test_a_copy_that_is_interrupted_leaves_nothing(postgresql: Server, tmp_path: Path) -> None:
    file, url = str(tmp_path / "a.db"), postgresql.url()
    with closing(Store(Journal(file))) as store:
        in_process.play(START, store=store)

    def stop(table: str, _: int) -> None:
        if table == "message":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        copy(file, url, stop)
    copy(file, url)
