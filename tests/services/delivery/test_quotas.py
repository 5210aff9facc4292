"""Who is let in cannot make others grow or hang: each process bounds what it takes."""

import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.delivery import inactivity
from cogradar.services.delivery.inactivity import FORGET_S, MAX_RUNS, MOST_S, Inactivity
from cogradar.services.delivery.pacing import MAX_AHEAD_DWELLS, MAX_AHEAD_S
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder import core as recorder
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Refused, RunCancel, Waveform
from cogradar.shared.protocol.recovery import History, ScanRecall
from cogradar.shared.wire.codec import BadMessage, decode, encode
from cogradar.shared.wire.runner import TICK_S, Core
from tests.samples import sample
from tests.services.loop import checkpoint, play, smoke_start, waveforms


@pytest.mark.parametrize("targets", [[0] * 4096, [1, 2, 1]])
def test_a_recall_names_each_track_once(targets: list[int]) -> None:
    payload = encode(sample(ScanRecall).model_copy(update={"targets": targets}))
    with pytest.raises(BadMessage, match="must all be different"):
        decode(payload)


def test_what_is_recalled_in_a_tick_is_bounded_and_comes_with_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "RECALLED_BYTES", 3 << 10)
    core, start = RecorderCore(Journal(":memory:")), smoke_start()
    for message in [start, *play(start)]:
        core.handle(message)
    recall = ScanRecall(run=start.run, k=0, targets=[0], planner="p")
    for _ in range(2):
        n_byte = 0
        while n_byte < 3 << 10:
            answers = [answer for answer in core.handle(recall) if isinstance(answer, History)]
            n_byte += sum(len(payload) for answer in answers for payload in answer.payloads)
        with pytest.raises(Refused, match="MiB were recalled in this tick already"):
            core.handle(recall)
        core.handle(Tick(0.0))


@pytest.mark.parametrize(
    "make", [lambda: EmulatorCore(SimulatedFrontEnd.open), lambda: PlannerCore("p"), AllocatorCore]
)
def test_a_worker_knows_so_many_runs_and_no_more(make: type[Core], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inactivity, "MAX_RUNS", 4)
    core = make()
    begun = [checkpoint(smoke_start(run=f"r{i}")) for i in range(5)]
    for one in begun[:4]:
        core.handle(one)
    with pytest.raises(Refused, match="4 runs are known"):
        core.handle(begun[4])
    core.handle(begun[0])  # of those that are known, more may come
    core.handle(begun[1].model_copy(update={"ended": True}))
    core.handle(begun[4])


def test_the_recorder_begins_so_many_runs_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "MAX_RUNS", 3)
    core = RecorderCore(Journal(":memory:"))
    for i in range(3):
        core.handle(smoke_start(run=f"r{i}"))
    with pytest.raises(Refused, match="3 runs go on"):
        core.handle(smoke_start(run="r3"))
    core.handle(RunCancel(run="r1"))
    assert core.handle(smoke_start(run="r3"))


def test_a_run_that_hardly_moves_is_forgotten_after_a_day_and_slower_ones_are_none() -> None:
    slow = smoke_start(dwells=1_000_000).model_copy(update={"rate_hz": 0.001})
    known = Inactivity()
    known.after(checkpoint(slow))
    seconds = range(int(FORGET_S + MOST_S) + 2)
    assert [(run, s) for s in seconds for run in known.after(Tick(float(s)))] == [
        (slow.run, int(FORGET_S + MOST_S) + 1)
    ]
    for rate_hz in (1e-9, 0.0009, -1.0, 1001.0):
        with pytest.raises(BadMessage, match="rate_hz"):
            decode(encode(checkpoint(slow).model_copy(update={"rate_hz": rate_hz})))


def test_nobody_moves_the_radar_on_by_a_waveform_of_a_dwell_to_come() -> None:
    """But one that comes back goes on where the others are."""
    rate_hz, dwells = 100.0, 100_000
    start = smoke_start(dwells=dwells).model_copy(update={"rate_hz": rate_hz})
    tracking = next(waveform for waveform in waveforms(play(smoke_start())) if waveform.tracking)
    most = MAX_AHEAD_DWELLS + int(MAX_AHEAD_S * rate_hz)

    def at(k: int) -> Waveform:
        return tracking.model_copy(update={"k": k})

    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(checkpoint(start, 10, 5))
    core.handle(at(2_000))
    (scan, _) = core.handle(Tick(0.0))
    assert getattr(scan, "k", None) == 2_001
    with pytest.raises(Refused, match=rf"waveform of dwell {2_002 + most + 1}, {most + 1} dwells ahead of the radar"):
        core.handle(at(2_002 + most + 1))
    for far in (2**31 - 1, dwells + 10_000):
        with pytest.raises(Refused, match=f"dwell {far} of a run that ends by"):
            core.handle(at(far))
    core.handle(at(2_002 + most))
    (scan, _) = core.handle(Tick(TICK_S))
    assert getattr(scan, "k", None) == 2_002 + most + 1


def test_the_limit_of_runs_is_that_of_the_documents() -> None:
    assert MAX_RUNS == recorder.MAX_RUNS == 4096
