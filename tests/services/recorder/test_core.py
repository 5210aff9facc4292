"""The recorder: what it journals, what its checkpoints acknowledge, and how it comes back."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest

from services.delivery.resend import ResendBuffer
from services.recorder.core import BEHIND_TICKS, RecorderCore
from services.recorder.journal import Journal
from shared.protocol.events import Tick
from shared.protocol.messages import (
    Checkpoint,
    EmulatorCheckpoint,
    Message,
    Plan,
    Refused,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from shared.protocol.recovery import History, ScanRecall, Snapshot, WaveformRecall
from shared.wire.codec import encode
from tests.samples import digest, sample
from tests.services.loop import SMOKE, checkpoints, plans, play, scans, smoke_start, waveforms

Acknowledged = tuple[int, int, bool]


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=20))


def _recorded(messages: Iterable[Message]) -> Journal:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    for message in messages:
        assert all(isinstance(answer, Checkpoint) for answer in core.handle(message))
    return journal


def _checkpoints(core: RecorderCore, messages: Iterable[Message | Tick]) -> list[Acknowledged]:
    answers = [answer for message in messages for answer in core.handle(message)]
    return [(a.k, a.t, a.ended) for a in answers if isinstance(a, Checkpoint) and not isinstance(a, EmulatorCheckpoint)]


def _rows(journal: Journal) -> list[dict[str, object]]:
    return journal.read("SELECT run, k, topic, item, payload FROM message ORDER BY run, k, topic, item")


# What it journals.


def test_a_run_is_journalled_from_start_to_end(sent: list[Message]) -> None:
    journal = _recorded(sent)
    (run,) = journal.read("SELECT * FROM run")
    n = len(scans(sent))
    assert (run["run"], run["strategy"], run["seed"], run["dwells"]) == ("r", "power-aware", 1, 20)
    assert (run["status"], run["acknowledged_k"], run["acknowledged_t"]) == ("complete", n, 20)
    assert run["acquisition_scans"] == sum(scan.t == 0 for scan in scans(sent))
    kept = journal.read("SELECT topic, COUNT(*) AS n FROM message GROUP BY topic")
    assert {row["topic"]: row["n"] for row in kept} == {"scan": n, "truth": n, "waveform": n, "plan": 2 * n}
    assert journal.read("SELECT * FROM score") == []  # others derive them


def test_the_digest_covers_scans_plans_and_waveforms_in_order(sent: list[Message]) -> None:
    """Independently: per dwell plans by track, the scan, the waveform (topics in alphabetical order)."""
    ordered: list[Message] = []
    for scan, waveform in zip(scans(sent), waveforms(sent), strict=True):
        ordered += {plan.target: plan for plan in plans(sent) if plan.k == scan.k}.values()
        ordered += [scan, waveform]
    assert _recorded(sent).read("SELECT digest FROM run") == [{"digest": digest(ordered)}]


def test_order_of_arrival_and_repetition_do_not_matter(sent: list[Message]) -> None:
    one, other = _recorded(sent), _recorded([*sent[::-1], *sent])
    assert _rows(one) == _rows(other)
    columns = "SELECT digest, acknowledged_k, acknowledged_t, status, conflicts FROM run"
    assert one.read(columns) == other.read(columns)


def test_a_message_that_differs_from_the_first_is_counted_and_refused(sent: list[Message]) -> None:
    """Before and after its dwell is complete."""
    journal, first = Journal(":memory:"), plans(sent)[0]
    core, n = RecorderCore(journal), 0
    for until in (sent.index(first) + 1, len(sent) - 1):
        for message in sent[n:until]:
            core.handle(message)
        n = until
        with pytest.raises(Refused, match="plan of dwell 0 differs"):
            core.handle(first.model_copy(update={"n_sim": 7}))
    assert journal.read("SELECT conflicts FROM run") == [{"conflicts": 2}]


def test_a_failed_run_says_why() -> None:
    journal = _recorded([smoke_start(), RunEnd(run="r", k=0, t=0, status="failed", reason="no target")])
    assert journal.read("SELECT status, reason FROM run") == [{"status": "failed", "reason": "no target"}]


# What it acknowledges.


def test_checkpoints_come_at_the_start_every_sixteen_dwells_and_at_the_end(sent: list[Message]) -> None:
    """The clock is that of the last dwell acknowledged."""
    n, clock = len(scans(sent)), {scan.k: scan.t for scan in scans(sent)}
    assert 16 < n < 32
    assert _checkpoints(RecorderCore(Journal(":memory:")), sent) == [
        (0, 0, False),
        (16, clock[15], False),
        (n, 20, True),
    ]


def test_only_the_emulator_is_told_of_the_world() -> None:
    core, start = RecorderCore(Journal(":memory:")), smoke_start()
    assert core.handle(start) == checkpoints(start)


class PowerCut(Exception):
    """Between a commit and what follows it."""


def test_a_checkpoint_is_sent_only_after_the_commit_of_what_it_acknowledges(
    sent: list[Message], tmp_path: Path
) -> None:
    """Another connection sees at every checkpoint what it claims."""
    path = str(tmp_path / "runs.db")
    journal = Journal(path)
    core, reader = RecorderCore(journal), None
    for message in sent:
        for answer in core.handle(message):
            assert isinstance(answer, Checkpoint)
            reader = reader or Journal(path, read_only=True)
            (run,) = reader.read("SELECT acknowledged_k, acknowledged_t FROM run")
            assert (run["acknowledged_k"], run["acknowledged_t"]) == (answer.k, answer.t)
            (kept,) = reader.read("SELECT COUNT(*) AS n FROM message WHERE k < ?", [answer.k])
            assert kept["n"] == 5 * answer.k
    assert reader is not None
    reader.close()
    journal.close()


def test_no_checkpoint_without_a_commit(sent: list[Message], monkeypatch: pytest.MonkeyPatch) -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    core.handle(sent[0])

    def cut(_: Journal) -> None:
        raise PowerCut

    monkeypatch.setattr(Journal, "commit", cut)
    until = sent.index(waveforms(sent)[15])  # completes the sixteenth dwell
    assert [answer for message in sent[1:until] for answer in core.handle(message)] == []
    with pytest.raises(PowerCut):
        core.handle(sent[until])


def test_every_commit_is_synchronous(tmp_path: Path) -> None:
    journal = Journal(str(tmp_path / "runs.db"))
    assert journal.read("PRAGMA synchronous") == [{"synchronous": 2}]  # FULL
    journal.close()


def test_rows_are_committed_and_acknowledged_within_half_a_second(sent: list[Message]) -> None:
    """At the second of the ticks that come four times a second."""
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    _checkpoints(core, sent[: sent.index(waveforms(sent)[2]) + 1])
    assert journal.has_uncommitted
    assert _checkpoints(core, [Tick(0.25)]) == []
    core.handle(scans(sent)[3])
    assert _checkpoints(core, [Tick(0.5)])[0] == (3, scans(sent)[2].t, False)
    assert not journal.has_uncommitted


def test_a_run_that_stands_still_is_asked_for_what_it_lacks(sent: list[Message]) -> None:
    """After 2 ticks, then after 4, 8, 16 and 32; the dwells before are acknowledged."""
    core, start = RecorderCore(Journal(":memory:")), smoke_start(dwells=20)
    _checkpoints(core, sent[: sent.index(waveforms(sent)[1]) + 1])
    answers = {tick: list(core.handle(Tick(0.25 * tick))) for tick in range(1, 130)}
    asked, t = [2, 6, 14, 30, 62, 94, 126], scans(sent)[1].t
    assert answers.pop(2) == [*checkpoints(start, 2, t), *checkpoints(start, 2, t, resend=True)]
    for tick, answer in answers.items():  # every second, for who joins meanwhile
        is_said = tick in asked or tick % 4 == 0
        assert answer == (checkpoints(start, 2, t, resend=tick in asked) if is_said else [])


@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
def test_a_run_that_may_wait_for_its_turn_is_asked_for_later(sent: list[Message], rate_hz: float) -> None:
    """While messages of others in lockstep come: after two seconds, not half of one; overdue four times as late."""
    core, upto = RecorderCore(Journal(":memory:")), sent.index(waveforms(sent)[1]) + 1
    others = [message.model_copy(update={"run": "other"}) for message in sent]
    others[0] = others[0].model_copy(update={"rate_hz": rate_hz})
    for message in (*sent[:upto], scans(sent)[2], *others[:upto]):
        core.handle(message)
    asked, overdue, repeated = list[int](), list[int](), list[int]()
    for tick, message in enumerate(others[upto : upto + 40], 1):
        core.handle(message)
        said = [m for m in core.handle(Tick(0.25 * tick)) if isinstance(m, Checkpoint) and m.run == "r"]
        asked += [tick] * any(m.resend for m in said)
        overdue += [tick] * any(m.overdue for m in said)
        repeated += [tick] * any(not m.resend for m in said)
    assert asked == ([2, 6, 12, 24] if rate_hz else [8, 16, 24, 40])
    assert overdue == ([12, 24] if rate_hz else [])
    assert [tick for tick in repeated if tick > 2] == ([4, 8, 16, 20, 28, 32, 36, 40] if rate_hz else [32])


def test_a_radar_that_is_started_again_beside_other_runs_hears_of_its_own_within_a_second(sent: list[Message]) -> None:
    """In real time each dwell until then is lost."""
    core = RecorderCore(Journal(":memory:"))
    core.handle(sent[0].model_copy(update={"rate_hz": 10.0}))
    others = [message.model_copy(update={"run": "other"}) for message in sent]
    core.handle(others[0])
    said = list[int]()
    for tick, message in enumerate(others[1:41], 1):
        core.handle(message)
        said += [tick] * any(m.run == "r" for m in core.handle(Tick(0.25 * tick)) if isinstance(m, Checkpoint))
    assert {4, 8, 12, 16, 20} <= set(said)


def test_while_the_recorder_is_behind_time_hardly_passes_for_its_runs(sent: list[Message]) -> None:
    """What seems to be lacking may wait in its inbox, of all runs alike: then it is no matter that others go on."""
    core, upto = RecorderCore(Journal(":memory:")), sent.index(waveforms(sent)[1]) + 1
    others = [message.model_copy(update={"run": "other"}) for message in sent]
    for message in (*sent[:upto], *others[:upto]):
        core.handle(message)
    asked = list[int]()
    for tick, message in enumerate(others[upto : upto + 2 * BEHIND_TICKS], 1):
        core.handle(message)
        answers = core.handle(Tick(0.25 * tick, drained=False))
        asked += [tick] * any(m.resend and m.run == "r" for m in answers if isinstance(m, Checkpoint))
    assert asked == [2 * BEHIND_TICKS]


@pytest.mark.parametrize(("n_tick", "first"), [(1, 0), (5, 1), (10, 2), (30, 4)])
def test_who_only_is_slow_is_not_asked_for_ever(sent: list[Message], n_tick: int, first: int) -> None:
    core, asked = RecorderCore(Journal(":memory:")), Counter[int]()
    for message in sent:
        core.handle(message)
        if isinstance(message, Waveform) and message.k > 2:  # the dwell is complete with it
            for _ in range(n_tick):
                asked[message.k] += any(isinstance(m, Checkpoint) and m.resend for m in core.handle(Tick(0.0)))
    assert len(asked) > 6
    assert (asked[3], max(asked[k] for k in asked if k > 5)) == (first, 0)


def test_only_the_plans_that_all_wait_for_are_asked_for(sent: list[Message]) -> None:
    """Whoever is slow has not sent his yet, and the others need not send theirs again."""
    core = RecorderCore(Journal(":memory:"))
    upto = sent.index(scans(sent)[4])
    for message in sent[:upto]:
        core.handle(message)
    dwell = [m for m in sent[upto:] if getattr(m, "k", -1) == 4]
    sent_of_dwell = ResendBuffer(0)
    sent_of_dwell.add(4, dwell)
    for message in dwell:
        if isinstance(message, Scan | Truth) or (isinstance(message, Plan) and message.target == 0):
            core.handle(message)
    asked = [m for n in range(2) for m in core.handle(Tick(float(n))) if isinstance(m, Checkpoint) and m.resend]
    assert [m.lacking for m in asked] == [[1], [1]]
    wanted = [m for m in dwell if isinstance(m, Scan | Waveform) or (isinstance(m, Plan) and m.target == 1)]
    sent_of_dwell.acknowledge(asked[0])
    assert sent_of_dwell.again(drained=True) == wanted
    assert sent_of_dwell.again(drained=True) == []
    core.handle(next(m for m in wanted if isinstance(m, Plan)))
    asked = [m for n in range(9) for m in core.handle(Tick(float(n))) if isinstance(m, Checkpoint) and m.resend]
    assert asked[0].lacking is None  # nor has the waveform come: its allocator may lack any of the plans
    sent_of_dwell.acknowledge(asked[0])
    assert sent_of_dwell.again(drained=True) == dwell


def test_at_first_only_a_waveform_is_asked_for_that_is_all_that_lacks(sent: list[Message]) -> None:
    core = RecorderCore(Journal(":memory:"))
    for message in sent[: sent.index(waveforms(sent)[4])]:
        core.handle(message)
    asked = [m for n in range(9) for m in core.handle(Tick(float(n))) if isinstance(m, Checkpoint) and m.resend]
    assert [m.lacking for m in asked] == [[], [], None, None]


def test_an_end_that_is_sent_again_is_acknowledged_again(sent: list[Message]) -> None:
    core = RecorderCore(Journal(":memory:"))
    _checkpoints(core, sent)
    assert isinstance(sent[-1], RunEnd)
    assert [ended for _, _, ended in _checkpoints(core, [sent[-1]])] == [True]


def test_a_snapshot_is_kept_only_of_an_acknowledged_dwell(sent: list[Message]) -> None:
    """Complete is not enough: after a power cut nobody would plan the dwells up to it."""
    core = RecorderCore(Journal(":memory:"))
    _checkpoints(core, sent[: sent.index(waveforms(sent)[10]) + 1])
    snapshot = _snapshot(k=5)
    with pytest.raises(Refused, match="snapshot of dwell 5, only those before 0 are acknowledged"):
        core.handle(snapshot)
    _checkpoints(core, [Tick(0.25), Tick(0.5)])
    assert core.handle(snapshot) == ()
    (history,) = core.handle(ScanRecall(run="r", k=3, targets=[1], planner="p"))
    assert getattr(history, "topic", "") == "snapshot"


def _snapshot(k: int) -> Snapshot:
    n, n_bin = SMOKE.radar.belief.n_particle, SMOKE.radar.array.n_bin
    looked = np.zeros((1, n_bin))
    looked[0, 2] = 0.1
    made = sample(
        Snapshot, run="r", k=k, particles=np.ones((n, 4)), remembered=np.empty((0, 4)), looked=looked, modes=np.empty(0)
    )
    assert isinstance(made, Snapshot)
    return made


# How it comes back.


@pytest.mark.parametrize("cut", [1, 7, 40, 96, 105])
def test_a_recorder_that_comes_back_goes_on_where_the_journal_is(sent: list[Message], cut: int, tmp_path: Path) -> None:
    """Cut anywhere: in the acquisition, in its last dwell, in the middle of a dwell. What was not committed is lost."""
    path, whole = str(tmp_path / "runs.db"), _recorded(sent)
    first = Journal(path)
    _checkpoints(RecorderCore(first), sent[:cut])
    first.rollback()
    first.close()
    second = Journal(path)
    core = RecorderCore(second, resume=True)
    asked = [m for tick in (0.25, 0.5) for m in core.handle(Tick(tick)) if isinstance(m, Checkpoint) and m.resend]
    _checkpoints(core, [m for m in sent[1:] if getattr(m, "k", 0) >= asked[0].k])
    assert _rows(second) == _rows(whole)
    columns = "SELECT digest, acknowledged_k, acknowledged_t, acquisition_scans, status, conflicts FROM run"
    assert second.read(columns) == whole.read(columns)
    second.close()


def test_a_run_that_nobody_resumes_is_marked_as_interrupted() -> None:
    journal = _recorded([smoke_start()])
    RecorderCore(journal)
    assert journal.read("SELECT status, reason FROM run") == [{"status": "failed", "reason": "interrupted"}]


UNREADABLE = {
    "another schema": "UPDATE run SET document = json_remove(document, '$.radar.array') WHERE run = 'bad'",
    "no JSON": "UPDATE run SET document = '{' WHERE run = 'bad'",
    "a torn message": "UPDATE message SET payload = zeroblob(20) WHERE run = 'bad' AND topic = 'scan'",
}


@pytest.mark.parametrize("damage", UNREADABLE.values(), ids=UNREADABLE.keys())
def test_a_run_that_cannot_be_read_is_set_aside_and_the_others_go_on(damage: str, sent: list[Message]) -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    for message in sent[:-1]:
        core.handle(message.model_copy(update={"run": "bad"}))
    for message in sent[:40]:
        core.handle(message)
    journal.write("UPDATE run SET acknowledged_k = 3, acknowledged_t = 1 WHERE run = 'bad'")
    journal.write(damage)
    journal.commit()
    again = RecorderCore(journal, resume=True)
    (bad,) = journal.read("SELECT status, reason FROM run WHERE run = 'bad'")
    assert bad["status"] == "quarantined"
    assert bad["reason"]
    _checkpoints(again, sent[1:])
    assert journal.read("SELECT status FROM run WHERE run = 'r'") == [{"status": "complete"}]
    again.handle(scans(sent)[5].model_copy(update={"run": "bad"}))
    if journal.read("SELECT document FROM run WHERE run = 'bad'") == journal.read(
        "SELECT document FROM run WHERE run = 'r'"
    ):
        with pytest.raises(Refused, match="another run has this name"):
            again.handle(smoke_start(run="bad", seed=9))
    else:  # whoever began it is told that it is over
        assert _is_end(again.handle(smoke_start(run="bad")))


def _is_end(answers: Sequence[Message]) -> bool:
    return bool(answers) and all(isinstance(answer, Checkpoint) and answer.ended for answer in answers)


def test_a_message_that_is_torn_long_since_sets_its_run_aside_when_the_digest_comes_to_it(sent: list[Message]) -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    _checkpoints(core, sent[:-1])
    journal.write("UPDATE message SET payload = zeroblob(20) WHERE topic = 'scan' AND k = 2")
    journal.commit()
    again = RecorderCore(journal, resume=True)
    again.handle(smoke_start(run="other"))
    assert isinstance(sent[-1], RunEnd)
    assert _is_end(again.handle(sent[-1]))
    assert journal.read("SELECT run, status FROM run") == [
        {"run": "r", "status": "quarantined"},
        {"run": "other", "status": "running"},
    ]


@pytest.mark.parametrize("kind", [Scan, Truth, Plan, Waveform])
def test_what_comes_before_its_run_is_known_is_journalled_when_it_begins(
    kind: type[Message], sent: list[Message]
) -> None:
    journal = Journal(":memory:")
    core, early = RecorderCore(journal), next(message for message in sent if isinstance(message, kind))
    assert core.handle(early) == ()
    assert isinstance(sent[0], RunStart)
    core.handle(sent[0])
    assert [row["topic"] for row in _rows(journal)] == [kind.__name__.lower()]


@pytest.mark.parametrize(("rate_hz", "answered"), [(0.0, []), (10.0, [3])])
def test_in_real_time_a_waveform_that_is_missing_is_recalled_by_the_newest_before_it(
    rate_hz: float, answered: list[int], sent: list[Message]
) -> None:
    """All processes are started anew, and the journal has the last scan, but not its waveform: the radar goes on."""
    core = RecorderCore(Journal(":memory:"))
    core.handle(smoke_start(dwells=20).model_copy(update={"rate_hz": rate_hz}))
    for message in [*scans(sent)[:6], *waveforms(sent)[:4]]:
        core.handle(message)
    histories = [answer for answer in core.handle(WaveformRecall(run="r", k=5)) if isinstance(answer, History)]
    assert [history.k for history in histories] == answered
    assert [history.payloads for history in histories] == [[encode(waveforms(sent)[k])] for k in answered]


@pytest.mark.parametrize(("rate_hz", "recalled"), [(0.0, [1, 2]), (10.0, [1, 2, 5, 6])])
def test_scans_are_recalled_over_gaps_in_real_time_only(
    rate_hz: float, recalled: list[int], sent: list[Message]
) -> None:
    """In lockstep what is missing will come; in real time a dwell may never have happened."""
    core = RecorderCore(Journal(":memory:"))
    core.handle(smoke_start(dwells=20).model_copy(update={"rate_hz": rate_hz}))
    for k in (0, 1, 2, 5, 6):
        core.handle(scans(sent)[k])
    (history,) = core.handle(ScanRecall(run="r", k=1, targets=[0], planner="p"))
    assert isinstance(history, History)
    assert history.payloads == [encode(scans(sent)[k]) for k in recalled]
