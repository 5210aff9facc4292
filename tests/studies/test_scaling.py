"""What being distributed costs: the split of a dwell's latency, the model, its tables; no test depends on a time."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cogradar.services.errors import BadInput
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.wire.timestamps import Received, Sent
from studies import page as measured
from studies.processes.timestamps import RunTimestamps
from studies.scaling import runs as bench_scale
from studies.scaling import tables as scale_tables
from studies.scaling.model import READERS, need, needs, speed_up
from studies.scaling.runs import Latency, Measured, bytes_per_dwell, measure, middle, scenario, split
from tests.services.tables import assert_shown_whole

LATENCY = Latency(total=100.0, emulator=10.0, planner=80.0, allocator=5.0, queueing=1.0, transport=4.0)
CPU_MS = {"emulator": 12.0, "planner": 82.0, "allocator": 8.0, "metrics": 16.0, "router": 5.0}
N_BYTE = {"scan": 1000.0, "truth": 2000.0, "plan": 3000.0, "waveform": 4000.0}
THIRTY = Measured(30, 1, 100.0, LATENCY, CPU_MS, N_BYTE)
MEASURED = [
    Measured(3, 0, 10.0),
    Measured(3, 1, 12.0, replace(LATENCY, total=12.0, planner=8.0), CPU_MS, N_BYTE),
    Measured(30, 0, 96.0),
    THIRTY,
    Measured(30, 2, 64.0, LATENCY, CPU_MS, N_BYTE),
]


def test_thirty_targets_fly_in_bins_of_their_own_and_stay_there() -> None:
    thirty = scenario(30)
    states = thirty.simulated.initial_states()
    later = states + 60.0 * np.column_stack([states[:, 1], 0 * states[:, 1], states[:, 3], 0 * states[:, 3]])
    bins = angle_bin(spatial_frequency(states), thirty.radar.array.n_bin)
    assert len(set(bins.tolist())) == 30
    assert np.diff(bins).min() >= 2
    assert (angle_bin(spatial_frequency(later), thirty.radar.array.n_bin) == bins).all()
    assert (thirty.radar.array, thirty.radar.planner) == (scenario(3).radar.array, scenario(3).radar.planner)


def _timestamps() -> dict[str, RunTimestamps]:
    """Two dwells, k = 1 and 2, of two tracks on two planners; the chain of k goes by planner k's track."""
    emulator = RunTimestamps(0.0, [], [])
    allocator = RunTimestamps(0.0, [], [])
    planners = {1: RunTimestamps(0.0, [], []), 2: RunTimestamps(0.0, [], [])}
    for k in (1, 2):
        at = 1.0 * k
        allocator.sent.append(Sent("waveform", "r", k - 1, 0, at, 40))
        emulator.received.append(Received("waveform", "r", k - 1, 0, at + 0.01, at + 0.03, at + 0.1))
        emulator.sent.append(Sent("scan", "r", k, 0, at + 0.08, 10))
        for item, name in enumerate(planners):
            late = 0.2 if name == k else 0.0
            planners[name].received.append(Received("scan", "r", k, 0, at + 0.1, at + 0.11, at + 0.9))
            planners[name].sent.append(Sent("plan", "r", k, item, at + 0.3 + late, 20))
            arrived = at + 0.33 + late
            allocator.received.append(Received("plan", "r", k, item, arrived, arrived + 0.02, arrived + 0.1))
    allocator.sent.append(Sent("waveform", "r", 2, 0, 2.0 + 0.65, 40))
    return {"emulator-0": emulator, "allocator-0": allocator, "planner-1": planners[1], "planner-2": planners[2]}


def test_a_dwell_is_split_along_the_chain_of_its_last_plan() -> None:
    """Hand computed for k = 2: hops of 10, 20 and 30 ms; waits of 20, 10 and 20; 50, 390 and 100 ms of work."""
    (chain,) = split(_timestamps(), dwells=2)
    latency = Latency(*chain)
    expected = Latency(total=650.0, emulator=50.0, planner=390.0, allocator=100.0, queueing=50.0, transport=60.0)
    assert chain == pytest.approx(tuple(vars(expected).values()))
    parts = latency.emulator + latency.planner + latency.allocator + latency.queueing + latency.transport
    assert parts == pytest.approx(latency.total)


def test_bytes_are_those_of_the_newest_dwells() -> None:
    assert bytes_per_dwell(_timestamps(), dwells=1) == {"scan": 10.0, "plan": 40.0, "waveform": 40.0}


def test_the_run_of_the_middle_time_is_taken_whole() -> None:
    assert middle([MEASURED[3], MEASURED[0], MEASURED[4]]) is MEASURED[4]


def test_only_the_planners_part_is_shared() -> None:
    assert speed_up(LATENCY, 1) == 1.0
    assert speed_up(LATENCY, 2) == pytest.approx(100.0 / 60.0)
    assert speed_up(LATENCY, 10**9) == pytest.approx(5.0)


def test_what_a_hundred_targets_need_at_1_hz() -> None:
    """Four radars; a dwell of 100 ms ends in its second, so radars share planners: 4 x 82 ms / 80 % of a core."""
    found = need(THIRTY, 100, 1.0)
    assert (found.radars, found.systems, found.planners) == (4, 1, 1)
    assert found.planner_cores == pytest.approx(0.328)
    assert found.other_cores == pytest.approx(4 * 0.041)
    n_byte = 1000 * (1 + READERS["scan"]) + 2000 * 2 + 3000 * 3 + 4000 * 3
    assert found.megabytes_s == pytest.approx(4e-6 * n_byte)


def test_ten_times_a_second_a_dwell_must_end_in_its_period() -> None:
    """80 ms in 100 - 20: one planner would do, but at 820 ms a second it is too busy; metrics carries 5 radars."""
    found = need(THIRTY, 1000, 10.0)
    assert (found.radars, found.planners) == (34, 68)
    assert found.dwell_ms == pytest.approx(60.0)
    assert found.systems == 7
    never = need(THIRTY, 1000, 60.0)
    assert never.planners is None
    assert never.dwell_ms == pytest.approx(20.0)


def test_needs_grow_with_targets_and_rate() -> None:
    found = needs(MEASURED)
    assert [(n.targets, n.rate_hz) for n in found] == [(t, r) for t in (100, 1000, 10_000) for r in (1.0, 10.0)]
    assert all(a.megabytes_s < b.megabytes_s for a, b in zip(found[::2], found[1::2], strict=True))
    assert found == needs(MEASURED[::-1])


def test_a_page_gets_the_tables_between_its_markers(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- scale -->\nold\n<!-- /scale -->\nafter\n")
    for _ in range(2):
        measured.write(page, "scale", scale_tables.tables(MEASURED))
        text = page.read_text()
        assert text.startswith("before\n<!-- scale -->\n")
        assert text.endswith("<!-- /scale -->\nafter\n")
        assert "old" not in text
        assert "| 100 | 10 | 4 | 1 | 8 |" in text
        assert "| 30 | 2 | 64.00 | 15.6 | 1.50 | 1.56 | 1.67 |" in text


def test_the_tables_are_shown_whole() -> None:
    assert_shown_whole(scale_tables.tables(MEASURED))


def test_a_page_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    page = tmp_path / "scaling.md"
    page.write_text("<!-- scale -->\n<!-- /scale -->\n")
    (tmp_path / "scaling.md.new").mkdir()
    with pytest.raises(BadInput, match=r"scaling\.md: Is a directory"):
        measured.write(page, "scale", scale_tables.tables(MEASURED))


@pytest.mark.parametrize("text", ["", "<!-- scale -->", "<!-- /scale --> <!-- scale -->"])
def test_a_page_without_markers_is_an_error(text: str, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(BadInput, match="has no lines"):
        measured.write(page, "scale", scale_tables.tables(MEASURED))
    with pytest.raises(BadInput, match="No such file"):
        measured.write(tmp_path / "nowhere.md", "scale", scale_tables.tables(MEASURED))


@pytest.mark.zenoh
@pytest.mark.slow
def test_a_real_run_is_measured_and_its_parts_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_scale, "REPEATS", 1)
    monkeypatch.setattr(bench_scale, "DWELLS", {3: 60})
    monkeypatch.setattr(bench_scale, "planner_counts", lambda: (1,))
    local, remote = measure(lambda _: None, threading.Event())
    assert (local.planners, remote.planners) == (0, 1)
    assert remote.latency is not None
    assert remote.n_byte is not None
    assert set(remote.n_byte) == {"scan", "truth", "plan", "waveform"}
    assert remote.latency.planner > remote.latency.allocator
    assert remote.dwell_ms == remote.latency.total
