"""Scores are a function of the journal: derived wherever it can be read, as far as it is acknowledged, once."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.errors import StoreFailed
from cogradar.services.metrics import store as stores
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.scoring import sums
from cogradar.services.metrics.scoring.scorer import MessageFields, Scored, Scorer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, RunEnd, RunStart, Scan, Truth, Waveform
from cogradar.shared.signal.receiver import threshold
from tests.services.loop import SMOKE, plans, play, scans, smoke_start
from tests.services.stored import seal

DWELLS = 20


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


def _record(sent: list[Message], store: Store, start: RunStart | None = None) -> RecorderCore:
    core = RecorderCore(store.journal)
    core.handle(start or smoke_start(dwells=DWELLS))
    for message in sent:
        if not isinstance(message, RunStart | Checkpoint):
            core.handle(message)
    return core


def _scores(store: Store) -> list[dict[str, Any]]:
    store.derive()
    return store.read("SELECT * FROM score ORDER BY run, t, target")


def _t(store: Store) -> list[int]:
    return [row["t"] for row in _scores(store) if row["track"] == 1]


def _without(sent: list[Message], *gone: tuple[type[Message], int]) -> list[Message]:
    return [m for m in sent if (type(m), getattr(m, "t" if isinstance(m, Scan | Truth) else "k", -1)) not in gone]


def test_scores_follow_from_truth_scan_and_plan(sent: list[Message]) -> None:
    """Detected is the true bin's cell, tested and over the threshold; the estimate is the belief mean."""
    store = in_memory()
    _record(sent, store)
    truths = {message.t: message for message in sent if isinstance(message, Truth) and message.t > 0}
    by_t = {scan.t: scan for scan in scans(sent) if scan.t > 0}
    estimates = {(plan.t, plan.target): plan.estimate for plan in plans(sent) if plan.status == "tracking"}
    best_bins = {(plan.t, plan.target): plan.best_bin for plan in plans(sent) if plan.status == "tracking"}
    outages = dict[int, int]()
    shares = {m.k + 1: m.shares for m in sent if isinstance(m, Waveform)}
    rows = _scores(store)
    assert len(rows) == DWELLS * 2
    targets = SMOKE.simulated.targets
    track_of_target = [0, 1] if targets[0].begin[2] < targets[1].begin[2] else [1, 0]  # tracks go by bin
    for row in rows:
        truth, scan, m = truths[row["t"]], by_t[row["t"]], row["target"] - 1
        where = [i for i, bin_ in enumerate(scan.bins) if bin_ == truth.bins[m]]
        track = track_of_target[m]
        assert row["track"] == track + 1
        assert row["detected"] == any(scan.statistic[i] >= threshold(SMOKE.radar.detector.p_fa) for i in where)
        assert (row["x"], row["true_bin"], row["snr_db"]) == (truth.states[m, 0], truth.bins[m], truth.snr_db[m])
        assert row["y_hat"] == estimates[row["t"], track][2]
        assert row["bin"] == scan.beams[track, 0]
        assert row["share"] == shares[scan.k][track, 0]
        assert (row["late"], row["stale"]) == (0, 0)
        assert json.loads(row["cells"]) == [[row["bin"], row["share"]]]
        assert row["hit"] == (row["bin"] == row["true_bin"])
        assert row["best_bin"] == best_bins[row["t"] - 1, track]
        before = outages.get(row["target"], 0)
        outages[row["target"]] = 0 if row["best_bin"] == row["true_bin"] else before + 1
        assert row["outage"] == outages[row["target"]]


def test_a_run_is_scored_as_far_as_it_is_acknowledged_and_each_dwell_once(
    sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, store = in_memory(), in_memory()
    _record(sent, whole)
    dwells: list[int] = []
    score = Scorer.score

    def counted(self: Scorer, k: int, messages: Iterable[tuple[str, MessageFields]]) -> Scored | None:
        dwells.append(k)
        return score(self, k, messages)

    monkeypatch.setattr(Scorer, "score", counted)
    core = RecorderCore(store.journal)
    for message in sent:
        core.handle(message)
        (run,) = store.read("SELECT acknowledged_k AS k FROM run") or [{"k": 0}]
        store.derive()
        assert dwells == list(range(run["k"]))
    assert _scores(store) == _scores(whole)
    assert dwells == 2 * list(range(len(scans(sent))))
    _scores(store)  # a run that is over is not scored again
    assert len(dwells) == 2 * len(scans(sent))


@pytest.mark.parametrize("most", [1, 3, 1000])
def test_scoring_may_go_in_pieces(most: int, sent: list[Message], monkeypatch: pytest.MonkeyPatch) -> None:
    whole, store = in_memory(), in_memory()
    _record(sent, whole)
    _record(sent, store)
    monkeypatch.setattr(stores, "AT_ONCE", 7)
    for _ in scans(sent):
        store.derive(["r"], most)
    assert store.read("SELECT * FROM score ORDER BY run, t, target") == _scores(whole)


def test_a_reader_of_the_file_derives_what_the_writer_has(sent: list[Message], tmp_path: Path) -> None:
    """And writes nothing into it."""
    path = str(tmp_path / "runs.db")
    writer = Store(Journal(path))
    core = _record(sent[: len(sent) // 2], writer)
    core.handle(Tick(0.25))
    core.handle(Tick(0.5))
    before, reader = Path(path).read_bytes(), Store(Journal(path, read_only=True))
    assert _scores(reader) == _scores(writer) != []
    assert reader.read("SELECT * FROM main.score") == []
    reader.close()
    assert Path(path).read_bytes() == before
    writer.close()


def test_a_journal_that_was_restored_from_an_older_state_is_scored_anew(sent: list[Message], tmp_path: Path) -> None:
    path, half = str(tmp_path / "runs.db"), len(sent) // 2
    journal = Journal(path)
    for message in sent[:half]:
        RecorderCore(journal, resume=True).handle(message)
    core = RecorderCore(journal, resume=True)
    core.handle(Tick(0.0))
    core.handle(Tick(0.0))
    reader = Store(Journal(path, read_only=True))
    n = len(_scores(reader))
    journal.write("UPDATE run SET acknowledged_k = 5, acknowledged_t = 3")
    seal(journal)
    assert 0 < len(_scores(reader)) < n
    reader.close()
    journal.close()


def test_a_run_that_cannot_be_read_does_not_keep_the_others_from_being_scored(sent: list[Message]) -> None:
    store = in_memory()
    _record(sent, store)
    core = RecorderCore(store.journal, resume=True)
    for message in sent:
        core.handle(message.model_copy(update={"run": "bad"}))
    store.journal.write("UPDATE message SET payload = zeroblob(9) WHERE run = 'bad' AND topic = 'truth' AND k = 7")
    assert {row["run"] for row in _scores(store) if row["t"] == DWELLS} == {"r"}
    assert list(store.unreadable) == ["bad"]


def test_a_run_that_is_dropped_is_forgotten(sent: list[Message]) -> None:
    store = in_memory()
    _record(sent, store)
    assert _scores(store)
    store.journal.write("DELETE FROM run")
    store.forget_dropped()
    assert store.read("SELECT * FROM score") == []


# Real time.


def _in_real_time(sent: list[Message]) -> Store:
    store = in_memory()
    core = _record(sent, store, smoke_start(dwells=DWELLS).model_copy(update={"rate_hz": 10.0}))
    for _ in range(40):
        core.handle(Tick(0.0))
    return store


def test_a_run_that_is_dropped_while_it_is_copied_has_no_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a journal on a server, which another process writes."""
    store = in_memory()
    store.journal.add_run(smoke_start())
    store.scores, read = in_memory().scores, store.journal.read
    monkeypatch.setattr(store.journal, "read", lambda query, *of: [] if "*" in query else read(query, *of))
    assert store.derive(["r"])
    assert store.unreadable == {}


def test_a_dwell_is_scored_without_the_plan_that_did_not_come(sent: list[Message]) -> None:
    k = next(scan.k for scan in scans(sent) if scan.t == 3)
    assert _t(_in_real_time(_without(sent, (Plan, k)))) == list(range(1, DWELLS + 1))


def test_a_dwell_without_a_scan_or_a_truth_has_no_score(sent: list[Message]) -> None:
    assert _t(_in_real_time(_without(sent, (Scan, 3), (Truth, 5)))) == [1, 2, 4, *range(6, DWELLS + 1)]


def test_late_plans_and_stale_waveforms_are_columns_of_the_score(sent: list[Message]) -> None:
    changed: list[Message] = []
    first = next(scan.k for scan in scans(sent) if scan.t == 1)
    for message in sent:
        if isinstance(message, Waveform) and message.k == first:
            changed.append(message.model_copy(update={"late": np.array([0, 1], np.int32)}))  # radiated at t = 2, 3
        elif isinstance(message, Truth) and message.t == 3:
            changed.append(message.model_copy(update={"waveform_k": first}))
        else:
            changed.append(message)
    rows = _scores(_in_real_time(changed))
    assert [(row["t"], row["track"]) for row in rows if row["late"]] == [(2, 2), (3, 2)]
    assert sorted((row["t"], row["track"]) for row in rows if row["stale"]) == [(3, 1), (3, 2)]


def test_dwells_before_the_first_tracking_waveform_are_acquisition(sent: list[Message]) -> None:
    """Plans are there, their waveform is late: the clock stands still, nothing is scored, and it is counted as such."""
    switch = max(scan.k for scan in scans(sent) if scan.t == 0)
    once_more: list[Message] = []
    for message in sent:
        k = getattr(message, "k", 0)
        later = isinstance(message, Scan | Truth | Plan | Waveform | RunEnd) and k > switch
        once_more.append(message.model_copy(update={"k": k + 1}) if later else message)
    again = [m.model_copy(update={"k": switch + 1}) for m in sent if getattr(m, "k", 0) == switch]
    store = _in_real_time([*once_more, *again])
    assert _t(store) == list(range(1, DWELLS + 1))
    assert store.read("SELECT acquisition_scans AS n FROM run") == [{"n": switch + 2}]


# Without truth.


def test_without_truth_tracks_are_scored_by_the_cells_they_asked_for(sent: list[Message]) -> None:
    start = smoke_start(dwells=DWELLS)
    start = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    blind, seeing = in_memory(), in_memory()
    _record([message for message in sent if not isinstance(message, Truth)], blind, start)
    _record(sent, seeing)
    known = {(row["t"], row["track"]): row for row in _scores(seeing)}
    rows = _scores(blind)
    assert len(rows) == len(known)
    for row in rows:
        other = known[row["t"], row["track"]]
        same = ("bin", "x_hat", "vx_hat", "y_hat", "vy_hat", "share", "late", "stale")
        assert [row[name] for name in same] == [other[name] for name in same]
        assert [row[name] for name in ("true_bin", "snr_db", "x", "vx", "y", "vy")] == 6 * [None]
        assert row["target"] == row["track"]
        scan = next(scan for scan in scans(sent) if scan.t == row["t"])
        (tested,) = scan.statistic[scan.bins == row["bin"]]
        assert row["detected"] == (tested >= threshold(SMOKE.radar.detector.p_fa))


def test_without_truth_a_dwell_has_the_shares_of_the_waveform_that_its_scan_names(sent: list[Message]) -> None:
    """An allocator that is stopped for three dwells: the front end repeats its last waveform."""
    first = next(scan.k for scan in scans(sent) if scan.t == 2) - 1
    repeated = next(m for m in sent if isinstance(m, Waveform) and m.k == first)
    beams = {"waveform_k": first, "beams": repeated.beams}

    def late(message: Message) -> Message:
        is_late = isinstance(message, Scan | Truth) and first + 1 < message.k <= first + 4
        return message.model_copy(
            update={name: beams[name] for name in vars(message).keys() & beams} if is_late else {}
        )

    changed, start = [late(message) for message in sent], smoke_start(dwells=DWELLS)
    blind, seeing = in_memory(), in_memory()
    start = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    _record([message for message in changed if not isinstance(message, Truth)], blind, start)
    _record(changed, seeing)
    rows = _scores(blind)
    assert {row["t"] for row in rows if row["stale"]} == {3, 4, 5}
    for row in rows:
        if 2 <= row["t"] <= 5:
            assert row["share"] == pytest.approx(repeated.shares[row["track"] - 1].sum())
    known = [(row["t"], row["track"], row["share"], row["stale"]) for row in _scores(seeing)]
    assert [(row["t"], row["track"], row["share"], row["stale"]) for row in rows] == known
    assert answer(blind, "antennas", {"dwells": "3:5"})[0]["power"] == pytest.approx(
        answer(blind, "antennas", {"dwells": "2:2"})[0]["power"]
    )
    assert answer(blind, "antennas", {"dwells": "2:5"})[0]["n"] == 4
    powers = Result(StoredRun(lambda metric, asked: answer(blind, metric, asked), None)).antenna_powers
    assert (powers[2:5] == powers[1]).all()
    assert (powers[5] != powers[1]).any()


def test_scores_that_a_fault_of_the_store_cut_off_are_derived_anew(
    sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever was written of a batch when the fault came: the next answer is that of a store that had none."""
    store, other = in_memory(), in_memory()
    _record(sent, store)
    _record(sent, other)
    add = sums.add

    def fault(*_: object) -> None:
        monkeypatch.setattr(sums, "add", add)
        raise StoreFailed("disk full")

    monkeypatch.setattr(sums, "add", fault)
    with pytest.raises(StoreFailed):
        answer(store, "summary", {})
    assert _scores(store) == _scores(other)
    assert answer(store, "summary", {}) == answer(other, "summary", {})


def test_a_block_is_summed_when_it_is_full_or_when_somebody_asks(
    sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, other, add, n, summed = in_memory(), in_memory(), sums.add, 1, 0

    def counted(*given: Any) -> None:
        nonlocal summed
        summed += 1
        add(*given)

    _record(sent, store)
    _record(sent, other)
    monkeypatch.setattr(sums, "add", counted)
    while not store.derive(most=1):
        n += 1
    assert summed <= n // sums.DWELLS
    assert answer(store, "summary", {}) == answer(other, "summary", {})
