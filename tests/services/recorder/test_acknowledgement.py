"""The recorder: what its checkpoints acknowledge, and what it asks for again."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.delivery.resend import ResendBuffer
from cogradar.services.recorder.core import BEHIND_TICKS, RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import OVERDUE_S
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Refused, RunEnd, Scan, Truth, Waveform
from cogradar.shared.protocol.recovery import History, ScanRecall, Snapshot
from cogradar.shared.wire.codec import encode
from cogradar.shared.wire.runner import TICK_S
from tests.samples import sample
from tests.services.loop import SMOKE, checkpoint, checkpoints, scans, smoke_start, waveforms
from tests.services.recorder.conftest import acknowledged

pytestmark = pytest.mark.usefixtures("either_store")


def test_checkpoints_come_at_the_start_every_sixteen_dwells_and_at_the_end(sent: list[Message]) -> None:
    """The clock is that of the last dwell acknowledged."""
    n, clock = len(scans(sent)), {scan.k: scan.t for scan in scans(sent)}
    assert 16 < n < 32
    assert acknowledged(RecorderCore(Journal(":memory:")), sent) == [
        (0, 0, False),
        (16, clock[15], False),
        (n, 20, True),
    ]


def test_only_the_emulator_is_told_of_the_world() -> None:
    journal, start = Journal(":memory:"), smoke_start()
    assert RecorderCore(journal).handle(start) == checkpoints(start, epoch=journal.epoch)


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

    def cut() -> None:
        raise PowerCut

    monkeypatch.setattr(journal, "commit", cut)
    until = sent.index(waveforms(sent)[15])  # completes the sixteenth dwell
    assert [answer for message in sent[1:until] for answer in core.handle(message)] == []
    with pytest.raises(PowerCut):
        core.handle(sent[until])
    monkeypatch.undo()


def test_every_commit_is_synchronous(tmp_path: Path) -> None:
    journal = Journal(str(tmp_path / "runs.db"))
    assert journal.read("PRAGMA synchronous") == [{"synchronous": 2}]  # FULL
    journal.close()


def test_rows_are_committed_and_acknowledged_within_half_a_second(sent: list[Message]) -> None:
    """At the second of the ticks that come four times a second."""
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    acknowledged(core, sent[: sent.index(waveforms(sent)[2]) + 1])
    assert journal.has_uncommitted
    assert acknowledged(core, [Tick(0.25)]) == []
    core.handle(scans(sent)[3])
    assert acknowledged(core, [Tick(0.5)])[0] == (3, scans(sent)[2].t, False)
    assert not journal.has_uncommitted


def test_a_run_that_stands_still_is_asked_for_what_it_lacks(sent: list[Message]) -> None:
    """After 2 ticks, then after 4, 8, 16 and 32; the dwells before are acknowledged."""
    journal, start = Journal(":memory:"), smoke_start(dwells=20)
    core, epoch = RecorderCore(journal), journal.epoch
    acknowledged(core, sent[: sent.index(waveforms(sent)[1]) + 1])
    answers = {tick: list(core.handle(Tick(0.25 * tick))) for tick in range(1, 130)}
    asked, t = [2, 6, 14, 30, 62, 94, 126], scans(sent)[1].t
    again = checkpoints(start, 2, t, epoch=epoch, resend=True)
    assert answers.pop(2) == [*checkpoints(start, 2, t, epoch=epoch), *again]
    for tick, answer in answers.items():  # every second, for who joins meanwhile
        is_said = tick in asked or tick % 4 == 0
        assert answer == (checkpoints(start, 2, t, epoch=epoch, resend=tick in asked) if is_said else [])


def test_the_plans_of_a_dwell_that_lacks_its_waveform_alone_are_handed_to_the_allocator(sent: list[Message]) -> None:
    """When it was asked for before: no planner may be left that could send them again."""
    journal = Journal(":memory:")
    core, dwell_1 = RecorderCore(journal), [one for one in sent if getattr(one, "k", None) == 1]
    acknowledged(core, sent[: sent.index(waveforms(sent)[0]) + 1])
    for message in (one for one in dwell_1 if not isinstance(one, Waveform)):
        core.handle(message)
    answers = {tick: core.handle(Tick(0.25 * tick)) for tick in range(1, 30)}
    given = {tick: [one for one in answer if isinstance(one, History)] for tick, answer in answers.items()}
    plans = sorted((one for one in dwell_1 if isinstance(one, Plan)), key=lambda plan: plan.target)
    history = History(
        run="r", to="allocator", topic="plan", k=1, payloads=[encode(plan) for plan in plans], epoch=journal.epoch
    )
    assert {tick: found for tick, found in given.items() if found} == {6: [history], 14: [history]}
    (allocator := AllocatorCore()).handle(checkpoint(smoke_start(), k=1, t=scans(sent)[0].t))
    assert [encode(one) for one in allocator.handle(history)] == [encode(waveforms(sent)[1])]


def test_plans_are_late_after_their_scan_whatever_else_was_away(sent: list[Message]) -> None:
    """First the emulator for ten seconds, then the allocator: that says nothing of the planners."""
    core, overdue = RecorderCore(Journal(":memory:")), list[tuple[int, list[int]]]()
    acknowledged(core, sent[: sent.index(waveforms(sent)[0]) + 1])
    of_dwell_1 = [one for one in sent if getattr(one, "k", None) == 1 and not isinstance(one, Scan | Waveform)]
    come: dict[int, list[Message]] = {40: [scans(sent)[1]], 41: of_dwell_1, 80: [waveforms(sent)[1], scans(sent)[2]]}
    for tick in range(1, 100):
        for message in come.get(tick, ()):
            core.handle(message)
        said = core.handle(Tick(0.25 * tick))
        overdue += [(tick, one.overdue) for one in said if isinstance(one, Checkpoint) and one.overdue]
    assert overdue == 2 * [(80 + round(OVERDUE_S / TICK_S) - 1, [0, 1])]  # for the radar and for the emulator


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
    wanted = [m for m in dwell if not (isinstance(m, Plan) and m.target != 1)]
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
    acknowledged(core, sent)
    assert isinstance(sent[-1], RunEnd)
    assert [ended for _, _, ended in acknowledged(core, [sent[-1]])] == [True]


def test_a_snapshot_is_kept_only_of_an_acknowledged_dwell(sent: list[Message]) -> None:
    """Complete is not enough: after a power cut nobody would plan the dwells up to it."""
    core = RecorderCore(Journal(":memory:"))
    acknowledged(core, sent[: sent.index(waveforms(sent)[10]) + 1])
    snapshot = _snapshot(k=5)
    with pytest.raises(Refused, match="snapshot of dwell 5, only those before 0 are acknowledged"):
        core.handle(snapshot)
    acknowledged(core, [Tick(0.25), Tick(0.5)])
    assert core.handle(snapshot) == ()
    (history,) = core.handle(ScanRecall(run="r", k=3, targets=[1], planner="p"))
    assert getattr(history, "topic", "") == "snapshot"


def _snapshot(k: int) -> Snapshot:
    n, n_bin = SMOKE.radar.belief.n_particle, SMOKE.radar.array.n_bin
    looked = np.zeros((1, n_bin))
    looked[0, 2] = 0.1
    made = sample(Snapshot, run="r", k=k, belief=np.ones((n, 4)), remembered=np.empty((0, 4)), looked=looked)
    assert isinstance(made, Snapshot)
    return made
