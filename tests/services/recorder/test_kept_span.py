"""A run without an end: its oldest dwells are cut behind it, and none that somebody may still need."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder import core as recorder
from cogradar.services.recorder import kept_span
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal, Retention
from cogradar.services.recorder.store.seal import QUARANTINED
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.fields import MIXTURE
from cogradar.shared.protocol.messages import Checkpoint, Message, RunCancel, RunEnd, Waveform
from cogradar.shared.protocol.recovery import Snapshot
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.signal.array import LOOKS_ROW
from tests.samples import sample
from tests.services.births import HERE, THERE, plan, roster, scan, start_of, truth, waveform
from tests.services.stored import answered

pytestmark = pytest.mark.usefixtures("either_store")

ALWAYS, SPAN = 32, 40  # dwells
DT_S = start_of(1).scenario["radar"]["motion"]["dt_s"]
HOURS = Retention(hours=SPAN * DT_S / 3600.0)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_span, "ALWAYS_DWELLS", ALWAYS)


def _roster(k: int) -> tuple[dict[int, list[float]], Roster]:
    """Two tracks, of which the second began with the scan of dwell 200."""
    states = {} if k == 0 else {0: HERE} if k <= 200 else {0: HERE, 1: THERE}
    tracks = roster(states, confirmed=list(states), born=[1] if k == 201 else [])
    return states, tracks.model_copy(update={"born_k": tracks.ids * 200})


def _sent(k: int) -> list[Message]:
    states, tracks = _roster(k)
    plans = [plan(k, m, state) for m, state in states.items()]
    return [scan(k, tracks), truth(k, {0: HERE, 1: THERE}), *plans, waveform(k, _roster(k + 1)[1])]


def _play(core: RecorderCore, first: int, last: int) -> None:
    for k in range(first, last):
        for message in _sent(k):
            core.handle(message)
        if k % 16 == 0:
            core.handle(Tick(0.0))


def _ks(journal: Journal) -> tuple[int, int]:
    (row,) = journal.rows("SELECT MIN(k), MAX(k) FROM message")
    return row[0], row[1]


def _begun(dwells: int, keep: Retention, store: Store | None = None) -> tuple[Journal, RecorderCore]:
    journal = Journal(":memory:") if store is None else store.journal
    core = RecorderCore(journal, keep=keep)
    core.handle(start_of(dwells))
    return journal, core


def _snap(core: RecorderCore, track: int, k: int) -> None:
    belief = np.zeros(MIXTURE)
    belief[0, 0] = 1.0
    parts = {"belief": belief, "remembered": np.empty((0, 4)), "looked": np.empty((0, LOOKS_ROW))}
    made = sample(Snapshot, run="r", target=track, k=k, **parts)
    assert isinstance(made, Snapshot)
    core.handle(made)


def test_dwells_are_cut_by_time_up_to_the_oldest_snapshot_or_birth_that_a_track_is_rebuilt_from() -> None:
    journal, core = _begun(NO_END, HOURS)
    _play(core, 0, 300)
    assert _ks(journal)[0] == 0  # the first track has no snapshot: it is rebuilt from its first scan
    _snap(core, 0, 250)
    _play(core, 300, 380)
    assert _ks(journal)[0] == 200  # the second one was born then
    _snap(core, 1, 260)
    _play(core, 380, 425)
    assert _ks(journal)[0] == 250
    for first in range(425, 600, 25):
        for track in (0, 1):
            _snap(core, track, first - 20)
        _play(core, first, first + 25)
    oldest, newest = _ks(journal)
    assert newest - SPAN - 32 <= oldest <= newest - SPAN + 1
    (row,) = journal.rows("SELECT kept_k FROM run")
    assert row[0] == oldest
    assert journal.extent("r")[1] == core._spans["r"].n_byte


def test_dwells_are_cut_by_size_and_a_recorder_that_comes_back_goes_on_so() -> None:
    (journal, core), size = _begun(NO_END, Retention()), 0
    _play(core, 0, 100)
    _, size = journal.extent("r")
    journal, core = _begun(NO_END, Retention(bytes_of_run=size))
    for first in range(0, 600, 100):
        if first == 300:
            core = RecorderCore(journal, resume=True, keep=Retention(bytes_of_run=size))
        _play(core, first, first + 100)
        for track in (0, 1)[: 1 + (first >= 201)]:
            _snap(core, track, first + 50)
    assert size < journal.extent("r")[1] < 2.5 * size  # what is needed, of two tracks, is more than was allowed
    assert _ks(journal)[0] > 400
    core.handle(RunCancel(run="r"))
    assert journal.read("SELECT status, digest FROM run") == [{"status": "stopped", "digest": ""}]


def _again(journal: Journal, keep: Retention) -> RecorderCore:
    journal.commit()
    return RecorderCore(journal, resume=True, keep=keep)


def test_a_long_run_goes_on_before_its_messages_are_counted_and_is_cut_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(kept_span, "COUNTED", 100)
    monkeypatch.setattr(kept_span, "COUNTED_AT_ONCE", 50)
    journal, core = _begun(NO_END, Retention())
    _play(core, 0, 170)
    _snap(core, 0, 140)
    journal.write("DELETE FROM message WHERE run = 'r' AND k = 169 AND topic = 'waveform'")
    core = _again(journal, HOURS)
    span = core._spans["r"]
    assert 0 < span.n_counted < 200
    (newest,) = (message for message in _sent(169) if isinstance(message, Waveform))
    for message in (newest, *_sent(170)):
        assert list(core.handle(message)) == []
    assert not span.is_counted
    _play(core, 171, 190)
    assert _ks(journal)[0] == 0  # nothing is cut meanwhile
    while span.counted_k > 0:
        core.handle(Tick(0.0))
    assert span.n_byte == journal.extent("r")[1]
    for first in range(190, 240, 10):
        _play(core, first, first + 10)
    assert _ks(journal)[0] == 140


@pytest.mark.parametrize("most", [50, 1_000_000])
def test_messages_that_are_gone_are_missed_by_a_recorder_that_goes_on(
    most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At once in a short run; in a long one when it has counted them, some at each tick."""
    monkeypatch.setattr(kept_span, "COUNTED", 100)
    monkeypatch.setattr(kept_span, "COUNTED_AT_ONCE", most)
    journal, core = _begun(NO_END, Retention())
    _play(core, 0, 170)
    journal.write("DELETE FROM message WHERE run = 'r' AND k = 7 AND topic = 'scan'")
    core, told = _again(journal, Retention()), list[Message]()
    is_long = most == 50
    assert (len(core._runs) == 1) == is_long
    for _ in range(20):
        told += core.handle(Tick(0.0))
    ((status, reason),) = journal.rows("SELECT status, reason FROM run")
    assert status == QUARANTINED
    assert "messages of the dwells below 1" in reason
    assert [message.ended for message in told if isinstance(message, Checkpoint)][-1:] == [True] * is_long


def test_a_long_run_that_ends_before_all_is_counted_gets_no_digest_of_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_span, "COUNTED", 100)
    monkeypatch.setattr(kept_span, "COUNTED_AT_ONCE", 50)
    monkeypatch.setattr(recorder, "MOST_COUNTED", 100)
    journal, core = _begun(175, Retention())
    _play(core, 0, 170)
    journal.write("DELETE FROM message WHERE run = 'r' AND k = 7 AND topic = 'truth'")
    core = _again(journal, Retention())
    for k in range(170, 175):
        for message in _sent(k):
            core.handle(message)
    core.handle(RunEnd(run="r", k=174, t=175, status="complete", reason=""))
    for _ in range(4):
        core.handle(Tick(0.0))
    ((status, digest),) = journal.rows("SELECT status, digest FROM run")
    assert (status, digest) == (QUARANTINED, None)


def test_a_run_with_an_end_is_kept_whole() -> None:
    journal, core = _begun(1000, HOURS)
    _play(core, 0, 200)
    _snap(core, 0, 150)
    _play(core, 200, 300)
    assert _ks(journal)[0] == 0


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store(Journal(str(tmp_path / "s.db")))) as opened:
        yield opened


def test_scores_are_of_the_dwells_that_are_kept_and_answers_say_so(store: Store) -> None:
    whole = in_memory()
    _, core = _begun(NO_END, HOURS, store)
    _, others = _begun(NO_END, Retention(), whole)
    for first in range(0, 600, 50):
        for one in (core, others):
            _play(one, first, first + 50)
            for track in (0, 1)[: 1 + (first >= 200)]:
                _snap(one, track, first + 30)
        store.derive(["r"])
    (run,) = answer(store, "runs", {})
    assert (run["oldest_t"], run["dwells"]) == (_ks(store.journal)[0] + 1, None)
    rows = answer(store, "tracks", {})
    n_kept = store.read("SELECT COUNT(*) AS n FROM temp.derived")[0]["n"]
    assert len(rows) == n_kept < 2 * (SPAN + 64 + 16)
    assert rows == answer(whole, "tracks", {"dwells": f"{rows[0]['t']}:"})
    assert rows[0]["t"] == (run["oldest_t"] - 1) // 16 * 16 or rows[0]["t"] == run["oldest_t"] // 16 * 16
    assert {row["first_dwell"] for row in answer(store, "summary", {})} == {rows[0]["t"]}
    with pytest.raises(BadInput, match="the ones before were cut"):
        answer(store, "tracks", {"dwells": "1:20"})
    store.journal.commit()
    anew = answered(store.journal.path, "tracks")  # by metrics that comes back
    assert anew[0]["t"] == run["oldest_t"]
