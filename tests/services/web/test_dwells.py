"""Dwells as they are told: encoded once for streams and answers, kept within bounds, and packed for who can unpack."""

from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from cogradar.services.metrics import queries
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.store import in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.web.app import create
from cogradar.services.web.views import dwells
from tests.services.stored import seal
from tests.services.web.conftest import DWELLS, FAST_S, ask
from tests.services.web.long_run import long_run

RUNS = "/api/v1/runs"


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The dwells that are encoded, in their order."""
    found, encode = list[int](), dwells._dwell

    def counted(store: Any, known: Any, picture: Any, rows: Any) -> bytes:
        found.append(picture["t"])
        return encode(store, known, picture, rows)

    monkeypatch.setattr(dwells, "_dwell", counted)
    return found


def test_a_dwell_is_encoded_once_for_streams_and_answers(core: MetricsCore, encoded: list[int]) -> None:
    app = create(core, None, FAST_S)
    some = ask(app, f"{RUNS}/whole/dwells?dwells=3:4")
    events = ask(app, f"{RUNS}/whole/events")
    every = ask(app, f"{RUNS}/whole/dwells?dwells=1:")
    assert sorted(encoded) == list(range(1, DWELLS + 1))
    assert encoded[:2] == [3, 4]
    assert [dwell["t"] for dwell in every.json()["dwells"]] == list(range(1, DWELLS + 1))
    assert every.json()["dwells"][2:4] == some.json()["dwells"]
    assert events.text.count("\nid: ") == DWELLS - 1
    ask(app, f"{RUNS}/other/dwells?dwells=1:1")
    assert encoded[DWELLS:] == [1]


def test_a_run_that_was_rewound_is_encoded_anew(journal: Path, tmp_path: Path, encoded: list[int]) -> None:
    path = tmp_path / "runs.db"
    path.write_bytes(journal.read_bytes())
    core = MetricsCore(str(path))
    app = create(core, None, FAST_S)
    *_, newest = ask(app, f"{RUNS}/begun/dwells?dwells=1:").json()["dwells"]
    t, k = newest["t"], newest["k"]
    assert encoded == list(range(1, t + 1))
    for to_k, to_t in ((k, t - 1), (k + 1, t)):
        with closing(Journal(str(path))) as theirs:
            theirs.write("UPDATE run SET acknowledged_k = ?, acknowledged_t = ? WHERE run = 'begun'", to_k, to_t)
            seal(theirs)
        assert ask(app, f"{RUNS}/begun/dwells").json()["dwells"][0]["t"] == to_t
    core.close()
    assert encoded[t:] == [t - 1, t]


def test_of_an_acquisition_each_scan_is_read_once(core: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, messages = list[list[int]](), queries.messages

    def counted(store: Any, run: str, topic: str, ks: Any) -> Any:
        asked.append(list(ks))
        return messages(store, run, topic, ks)

    monkeypatch.setattr(queries, "messages", counted)
    kept = dwells.Encoded()
    told = [dwells.acquisition(core.store, kept, "whole", k) for k in (0, 1, 4)]
    assert asked == [[0], [1], [2, 3, 4]]
    assert told == [dwells.acquisition(core.store, dwells.Encoded(), "whole", k) for k in (0, 1, 4)]
    dwells.acquisition(core.store, kept, "other", 1)
    assert asked[-1] == [0, 1]


def test_what_is_kept_is_bounded_and_of_one_journal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dwells, "KEPT_BYTES", 100)
    kept, one, other = dwells.Encoded(), in_memory(), in_memory()
    for t in (1, 2):
        kept.put(one, ("r", 0, t), b"x" * 40)
    assert kept.get(one, ("r", 0, 1)) is not None
    kept.put(one, ("r", 0, 3), b"x" * 40)
    assert [kept.get(one, ("r", 0, t)) is not None for t in (1, 2, 3)] == [True, False, True]
    kept.put(one, ("r", 0, 3), b"x" * 60)  # again: counted once
    assert [kept.get(one, ("r", 0, t)) is not None for t in (1, 3)] == [True, True]
    kept.put(one, ("r", 0, 4), b"x" * 101)
    assert [kept.get(one, ("r", 0, t)) for t in (1, 3, 4)] == [None] * 3
    kept.put(one, ("r", 0, 1), b"x" * 40)
    kept.put(other, ("r", 0, 2), b"x" * 70)
    assert kept.get(other, ("r", 0, 1)) is kept.get(one, ("r", 0, 1)) is None
    assert kept.get(other, ("r", 0, 2)) is not None


def test_long_answers_are_packed_and_streams_are_not(web: httpx.Client) -> None:
    packed = web.get(f"{RUNS}/whole/dwells?dwells=1:")
    plain = web.get(f"{RUNS}/whole/dwells?dwells=1:", headers={"Accept-Encoding": "identity"})
    assert (packed.headers["content-encoding"], packed.headers["vary"]) == ("gzip", "Accept-Encoding")
    assert "content-encoding" not in plain.headers
    assert packed.json() == plain.json()
    assert int(packed.headers["content-length"]) < 0.6 * int(plain.headers["content-length"])
    for path in ("dwells?dwells=99:", "events"):
        assert "content-encoding" not in web.get(f"{RUNS}/whole/{path}").headers


def test_no_more_is_scored_than_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of a long run takes many seconds: the page shows its first dwell meanwhile."""
    monkeypatch.setattr("cogradar.services.metrics.store.AT_ONCE", 64)
    core = MetricsCore(str(long_run(tmp_path / "runs.db", 300)))
    app = create(core, None, FAST_S)

    def scored() -> int:
        ends = queries.ends(core.store, "long")
        return 0 if ends is None else ends[1]

    (first,) = ask(app, f"{RUNS}/long/dwells?dwells=1:1").json()["dwells"]
    assert scored() == 1
    assert len(ask(app, f"{RUNS}/long/dwells?dwells=1:").json()["dwells"]) == dwells.MAX_DWELLS
    assert scored() == dwells.MAX_DWELLS
    (last,) = ask(app, f"{RUNS}/long/dwells").json()["dwells"]
    assert (last["t"], scored()) == (300, 300)
    assert ask(app, f"{RUNS}/long/dwells?dwells=1:1").json()["dwells"] == [first]
    core.close()
