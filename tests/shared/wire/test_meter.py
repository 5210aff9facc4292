"""What a process counts of itself."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, EmulatorCheckpoint, Message, Scan, Waveform
from cogradar.shared.protocol.roster import announced_roster
from cogradar.shared.protocol.topics import BY_MESSAGE, Role, topic_of
from cogradar.shared.wire.bus import Inbox
from cogradar.shared.wire.exposition import METRICS, Exposition
from cogradar.shared.wire.meter import EDGES_S, FINE_EDGES_S, MAX_KEPT, Durations, Measures, Meter
from tests.samples import FIELDS, plan, sample

N_BYTE = 10


def of_dwell(kind: type[Message], k: int, **fields: Any) -> Message:
    return sample(kind, k=k, **fields)


def counted(measures: Measures, name: str, label: str) -> Any:
    values = measures[name]
    assert isinstance(values, dict)
    return values[label]


def test_messages_and_bytes_are_counted_by_topic_from_zero() -> None:
    meter = Meter(Role.PLANNER)
    assert counted(meter.measures(), "messages_sent", "plan") == 0
    meter.receive([sample(Scan), sample(Scan)], N_BYTE)
    for k in range(3):
        meter.send(plan(k), N_BYTE)
    measures = meter.measures()
    assert counted(measures, "messages_received", "scan") == 2
    assert counted(measures, "received_bytes", "scan") == N_BYTE
    assert counted(measures, "messages_sent", "plan") == 3
    assert counted(measures, "sent_bytes", "plan") == 3 * N_BYTE


def test_what_is_sent_again_is_counted_for_each_run_and_track_by_itself() -> None:
    meter = Meter(Role.PLANNER)
    for message in (plan(4), plan(4, target=7), plan(4, run="other"), plan(5), plan(4), plan(5), plan(6)):
        meter.send(message, N_BYTE)
    assert counted(meter.measures(), "messages_redelivered", "plan") == 2


def test_what_is_kept_per_run_is_bounded() -> None:
    meter = Meter(Role.PLANNER)
    for n in range(MAX_KEPT + 1):
        meter.send(plan(1).model_copy(update={"run": f"r{n}"}), N_BYTE)
    meter.send(plan(1).model_copy(update={"run": f"r{MAX_KEPT}"}), N_BYTE)
    meter.send(plan(1).model_copy(update={"run": "r0"}), N_BYTE)  # the first made room
    assert counted(meter.measures(), "messages_redelivered", "plan") == 1


def set_clock(now: Callable[[], float], monkeypatch: pytest.MonkeyPatch) -> None:
    """The meter's clock alone: other threads of this process read the real one."""
    monkeypatch.setattr("cogradar.shared.wire.meter.time", SimpleNamespace(monotonic=now))


def test_an_event_is_timed_from_its_begin_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([5.0, 5.02])
    set_clock(lambda: next(times), monkeypatch)
    meter = Meter(Role.PLANNER)
    meter.begin()
    meter.end(Tick(5.0))
    durations = counted(meter.measures(), "handling_seconds", "tick")
    assert durations.sum_s == pytest.approx(0.02)
    assert durations.counts[EDGES_S.index(0.02)] == 1


def emulated(rate_hz: float, *, at_s: float, monkeypatch: pytest.MonkeyPatch) -> Meter:
    """An emulator that knows a run and transmits at a time."""
    meter = Meter(Role.EMULATOR)
    set_clock(lambda: at_s, monkeypatch)
    meter.take(sample(EmulatorCheckpoint, rate_hz=rate_hz), 0.0)
    meter.begin()
    return meter


@pytest.mark.parametrize(("rate_hz", "stale", "in_time"), [(10.0, 1, 1), (0.0, 0, 0)])
def test_in_real_time_a_waveform_is_early_or_missing(
    rate_hz: float, stale: int, in_time: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    meter = emulated(rate_hz, at_s=1.0, monkeypatch=monkeypatch)
    meter.take(of_dwell(Waveform, 3), 0.8)
    set_clock(lambda: 1.03, monkeypatch)  # the front end takes so long
    meter.send(of_dwell(Scan, 4, t=1), N_BYTE)
    meter.send(of_dwell(Scan, 4, t=1), N_BYTE)  # again
    set_clock(lambda: 1.1, monkeypatch)
    meter.begin()
    meter.send(of_dwell(Scan, 5, t=2), N_BYTE)
    measures = meter.measures()
    margin, duration = measures["deadline_margin_seconds"], measures["dwell_seconds"]
    measuring = measures["scan_seconds"]
    assert isinstance(measuring, Durations)
    assert isinstance(margin, Durations)
    assert isinstance(duration, Durations)
    assert (measures["waveforms_stale"], sum(margin.counts)) == (stale, in_time)
    assert margin.sum_s == pytest.approx(0.2 * in_time)
    assert duration.sum_s == pytest.approx(0.1)
    assert measuring.sum_s == pytest.approx(0.03 if rate_hz else 0.0)


def test_late_plans_and_acknowledged_dwells_are_counted() -> None:
    allocator, recorder = Meter(Role.ALLOCATOR), Meter(Role.RECORDER)
    late = np.array([1, 0], dtype=np.int32)
    allocator.send(sample(Waveform).model_copy(update={"late": late}), N_BYTE)
    assert allocator.measures()["plans_late"] == 1
    for k in (2, 18, 18, 16, 34):  # repeated, restored from an older state
        recorder.send(of_dwell(Checkpoint, k, t=0), N_BYTE)
        recorder.send(of_dwell(EmulatorCheckpoint, k, t=0), N_BYTE)
    assert recorder.measures()["dwells"] == 16 + 18  # those before the first are another process's


def test_confirmed_tracks_that_end_are_counted_once() -> None:
    allocator, waveform = Meter(Role.ALLOCATOR), sample(Waveform)
    for k, ids, confirmed in (
        (5, [0, 3, 4], [1, 1, 0]),
        (6, [0, 3], [1, 1]),
        (7, [0], [1]),
        (7, [0], [1]),
        (6, [], []),
    ):
        changed = {"ids": np.array(ids, np.int32), "confirmed": np.array(confirmed, np.int32)}
        roster = announced_roster(len(ids)).model_copy(update=changed)
        allocator.send(waveform.model_copy(update={"k": k, "roster": roster}), N_BYTE)
    assert allocator.measures()["tracks_ended"] == 1  # 3: 4 was tentative, and the last two are sent again


def test_a_dropped_message_is_counted_by_the_topic_of_its_key() -> None:
    inbox = Inbox()
    for key in ("cogradar/10/x/run/a/plan/3", "cogradar/10/y/run/b/plan/4", "cogradar/10/x/run/a/b/scan", "elsewhere"):
        inbox.drop(key, "bad")
    assert inbox.bad_of_topic == {"plan": 2, "other": 2}
    assert {kind: topic_of(BY_MESSAGE[kind].key_of(sample(kind), "x")) for kind in FIELDS} == {
        kind: BY_MESSAGE[kind].name for kind in FIELDS
    }


def test_the_text_holds_every_number_and_what_it_means() -> None:
    durations = Durations(FINE_EDGES_S)
    for seconds in (5e-5, 0.11, 20.0):
        durations.observe(seconds)
    text = Exposition(lambda: {"dwells": 3, "runs": {"running": 2}, "dwell_seconds": durations}).text().decode()
    lines = text.splitlines()
    assert "cogradar_dwells_total 3.0" in lines
    assert 'cogradar_runs{status="running"} 2.0' in lines
    assert f"# HELP cogradar_runs {METRICS['runs'].text}" in lines
    assert 'cogradar_dwell_seconds_bucket{le="0.1"} 1.0' in lines
    assert 'cogradar_dwell_seconds_bucket{le="0.125"} 2.0' in lines
    assert 'cogradar_dwell_seconds_bucket{le="+Inf"} 3.0' in lines
    assert "process_open_fds" in text


def test_a_number_of_another_kind_than_its_meaning_is_a_bug() -> None:
    with pytest.raises(TypeError, match="dwells"):
        Exposition(lambda: {"dwells": Durations()}).text()
