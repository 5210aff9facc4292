"""When a dwell is complete: with everything in lockstep, with what there is in real time, without a truth."""

from collections.abc import Iterable

import pytest

from cogradar.services.delivery.pacing import REST_S
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import RecordedRun
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import (
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
from cogradar.shared.wire.runner import TICK_S, Flush
from tests.services.loop import SMOKE, play, scans, smoke_start

RATE_HZ = 10.0


def _start(dwells: int = 6) -> RunStart:
    return smoke_start(dwells=dwells).model_copy(update={"rate_hz": RATE_HZ})


def _recorded(
    sent: list[Message], lacking: tuple[type[Message], ...] = (), start: RunStart | None = None
) -> tuple[RecorderCore, Journal]:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    core.handle(start or _start())
    for message in sent:
        if not isinstance(message, (RunStart, Checkpoint, *lacking)):
            core.handle(message)
    return core, journal


def _without(sent: list[Message], *gone: tuple[type[Message], int]) -> list[Message]:
    return [m for m in sent if (type(m), getattr(m, "t" if isinstance(m, Scan | Truth) else "k", -1)) not in gone]


def _pass_time(core: RecorderCore) -> None:
    for _ in range(round(REST_S / TICK_S)):
        core.handle(Tick(0.0))


def _complete(core: RecorderCore, journal: Journal) -> tuple[int, int]:
    """Dwells that are complete, and the clock of the last."""
    core.handle(Tick(0.0))
    core.handle(Tick(0.0))
    (run,) = journal.read("SELECT acknowledged_k AS k, acknowledged_t AS t FROM run")
    return run["k"], run["t"]


def test_a_dwell_is_completed_without_the_plan_that_does_not_come() -> None:
    """It waits while something may come; after the end it waits for so many ticks, then the run is over."""
    sent = play(smoke_start(dwells=6))
    k = next(scan.k for scan in scans(sent) if scan.t == 3)
    core, journal = _recorded(_without(sent, (Plan, k)))
    assert _complete(core, journal) == (k, 2)
    answers = [m for _ in range(20) for m in core.handle(Tick(0.0))]
    assert isinstance(answers[-1], Checkpoint)
    assert answers[-1].ended
    assert _complete(core, journal) == (scans(sent)[-1].k + 1, 6)
    assert journal.read("SELECT status FROM run") == [{"status": "complete"}]


def test_dwells_go_on_being_completed_some_time_after_newer_ones_have_come() -> None:
    sent = play(smoke_start(dwells=40))
    k = next(scan.k for scan in scans(sent) if scan.t == 3)
    core, journal = _recorded(_without(sent, (Plan, k), (Scan, 40)), (RunEnd,), _start(40))
    assert _complete(core, journal) == (k, 2)
    _pass_time(core)
    core.handle(next(scan for scan in scans(sent) if scan.t == 40))
    assert _complete(core, journal)[1] == 40


def test_what_comes_topic_by_topic_is_all_completed() -> None:
    """As to a recorder that was away for a while: many scans before the first of the truths."""
    sent = play(smoke_start(dwells=40))
    topics = (Scan, Waveform, Plan, Truth)
    by_topic: list[Message] = [message for topic in topics for message in sent if isinstance(message, topic)]
    core, journal = _recorded(by_topic, start=_start(40))
    assert _complete(core, journal) == (len(scans(sent)), 40)


def test_a_recorder_that_comes_back_in_real_time_asks_once_for_what_it_missed() -> None:
    sent = play(smoke_start(dwells=40))
    _, journal = _recorded([m for m in sent if getattr(m, "k", 0) <= 10], (RunEnd,), _start(40))
    journal.commit()
    core = RecorderCore(journal, resume=True)
    asked = []
    for scan in scans(sent)[11:18]:  # which come all the while
        core.handle(scan)
        asked.append([m.k for m in core.handle(Tick(0.0)) if isinstance(m, Checkpoint) and m.resend])
    assert [ks for ks in asked if ks] == [[11, 11]]  # to the radar's processes and to the emulator


def test_a_checkpoint_says_which_dwell_is_due_by_the_clock_since_the_newest_scan() -> None:
    """At least: the time between two ticks is not known. One that comes back knows the scans of its journal alone."""
    sent = scans(play(smoke_start(dwells=6)))
    core, journal = _recorded([])
    due, last_k = list[int](), sent[2].k

    def note(answers: Iterable[Message | Flush]) -> None:
        said = [one for one in answers if isinstance(one, EmulatorCheckpoint)]
        assert {one.newest_k for one in said} <= {last_k}
        due.extend(one.due_k for one in said)

    core.handle(Tick(0.0))
    for scan in sent[:3]:
        core.handle(scan)
    for tick in range(1, 13):
        note(core.handle(Tick(tick * TICK_S)))
    assert due[0] > last_k
    assert due[-1] == last_k + 1 + int((12 - 1) * TICK_S * RATE_HZ)
    journal.commit()
    back = RecorderCore(journal, resume=True)
    due.clear()
    for tick in range(12):
        note(back.handle(Tick(tick * TICK_S)))
    assert set(due) == {last_k + 1}


def test_a_scan_that_is_missing_although_a_later_one_has_come_is_asked_for_until_it_comes() -> None:
    sent = play(smoke_start(dwells=40))
    k = next(scan.k for scan in scans(sent) if scan.t == 3)
    core, _ = _recorded(_without(sent, (Scan, 3)), (RunEnd,), _start(40))
    asked = [[m for m in core.handle(Tick(0.0)) if isinstance(m, Checkpoint) and m.resend] for _ in range(6)]
    assert [[m.k for m in found] for found in asked] == [[k, k], [], [], [k, k], [], []]
    assert all(m.lacking == [] for found in asked for m in found)  # plans would only make the next ones late
    core.handle(next(scan for scan in scans(sent) if scan.t == 3))
    assert not [m for _ in range(6) for m in core.handle(Tick(0.0)) if isinstance(m, Checkpoint) and m.resend]


def test_a_dwell_without_a_scan_takes_its_time() -> None:
    sent = play(smoke_start(dwells=40))
    core, journal = _recorded(_without(sent, (Scan, 3), (Scan, 40)), (RunEnd,), _start(40))
    _pass_time(core)
    core.handle(next(scan for scan in scans(sent) if scan.t == 40))
    core.handle(next(m for m in sent if isinstance(m, RunEnd)))
    assert journal.read("SELECT acknowledged_t AS t, status FROM run") == [{"t": 40, "status": "complete"}]


def _ticked(run: RecordedRun) -> RecordedRun:
    run.tick(others_go_on=False)
    return run


@pytest.mark.parametrize("rate_hz", [10.0, 2.0, 1.0, 0.1])
def test_a_run_that_goes_on_is_not_asked_to_repeat_itself(rate_hz: float) -> None:
    """In real time scans come all the while, or something is lost."""
    run = RecordedRun(_start(dwells=20).model_copy(update={"rate_hz": rate_hz}))
    period = max(1, round(1.0 / rate_hz / TICK_S))
    for scan in scans(play(smoke_start(dwells=6))):
        for _ in range(period):
            run.tick(others_go_on=False)
            assert not run.wants_resend
        run.take(scan)
    until = round((1.0 / rate_hz + REST_S) / TICK_S)
    assert [_ticked(run).wants_resend for _ in range(until)] == [False] * (until - 1) + [True]


def test_what_comes_of_a_dwell_lets_the_rest_of_it_be_waited_for() -> None:
    sent = play(smoke_start(dwells=6))
    run = RecordedRun(smoke_start(dwells=6))
    run.take(scans(sent)[0])
    assert not _ticked(run).wants_resend
    run.take(next(m for m in sent if isinstance(m, Plan) and m.k == 0))
    assert [_ticked(run).wants_resend for _ in range(2)] == [False, True]


def test_at_a_low_rate_a_dwell_waits_for_plans_as_long_as_their_searches_may_take() -> None:
    """Plans and waveforms are in time, 3.5 s after the scan in a period of 10 s: nothing is closed without them."""
    start, sent = smoke_start(dwells=6).model_copy(update={"rate_hz": 0.1}), play(smoke_start(dwells=6))
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    core.handle(start)
    for k in range(max(scan.k for scan in scans(sent)) + 1):
        of_dwell = [m for m in sent if not isinstance(m, RunStart | Checkpoint | RunEnd) and getattr(m, "k", -1) == k]
        for kinds, ticks in (((Scan, Truth), 14), ((Plan, Waveform), 26)):
            for message in of_dwell:
                if isinstance(message, kinds):
                    core.handle(message)
            for _ in range(ticks):
                core.handle(Tick(0.0))
    (n,) = journal.read("SELECT COUNT(*) AS n FROM message WHERE topic IN ('plan', 'waveform')")
    assert n["n"] == 3 * len(scans(sent))


@pytest.mark.parametrize("rate_hz", [0.0, RATE_HZ])
def test_without_a_world_a_dwell_is_complete_without_a_truth(rate_hz: float) -> None:
    sent, start = play(smoke_start(dwells=6)), smoke_start(dwells=6)
    start = start.model_copy(update={"scenario": start.scenario | {"world": None}, "rate_hz": rate_hz})
    core, journal = _recorded(sent, (Truth,), start)
    assert journal.read("SELECT status, acknowledged_t AS t, has_truth FROM run") == [
        {"status": "complete", "t": 6, "has_truth": 0}
    ]
    core = _recorded(sent[:3], (Truth,), start)[0]
    with pytest.raises(Refused, match="truth"):
        core.handle(next(m for m in sent if isinstance(m, Truth)))


def test_a_dwell_that_a_run_cannot_have_is_refused() -> None:
    """The recorder would complete all dwells before it as missing."""
    sent = play(smoke_start(dwells=6))
    core, _ = _recorded([])
    far = scans(sent)[-1].model_copy(update={"k": 2 * SMOKE.radar.acquisition.max_scans + 7})
    with pytest.raises(Refused, match=f"dwell {far.k} of a run that ends by {far.k - 1}"):
        core.handle(far)


@pytest.mark.parametrize("is_first_lost", [False, True])
def test_an_emulator_that_comes_back_after_the_end_and_skips_to_a_later_one_adds_no_dwell(
    is_first_lost: bool,
) -> None:
    """It began in mid-acquisition, by a checkpoint of that time, and skipped to the waveform of the newest dwell."""
    sent = play(smoke_start(dwells=6))
    (end,) = (message for message in sent if isinstance(message, RunEnd))
    core, journal = _recorded([m for m in sent if not (is_first_lost and m is end)], lacking=(Plan,))
    core.handle(end.model_copy(update={"k": end.k + 1}))
    _pass_time(core)
    k, t = _complete(core, journal)
    assert (k, t) == (end.k + 1 + is_first_lost, end.t)
