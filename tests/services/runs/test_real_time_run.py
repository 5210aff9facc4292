"""Real processes in real time: the radar transmits on every dwell, whoever is killed."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from cogradar.services.kernels import compile_all
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs.launcher import LocalProcesses
from cogradar.services.runs.run import Progress
from cogradar.shared.protocol.messages import Truth
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.wire.codec import decode
from studies.processes import realtime as bench_realtime
from studies.processes.many_targets import many_targets
from studies.processes.realtime import Cell, Probe, highest_rate
from tests.services.loop import smoke_start
from tests.services.stored import rows
from tests.services.tables import assert_shown_whole

# Slow enough for a machine that starts a process meanwhile: a radar without the processor for a dwell skips it.
RATE_HZ, DWELLS = 4.0, 40


class Killer:
    """Kills these processes, one after the other, when the run has come to a dwell."""

    def __init__(self, victims: Sequence[str], after: int) -> None:
        self._left, self._after, self._t = list(victims), after, 0

    def see(self, progress: Progress) -> None:
        """How far the run is."""
        self._t = progress.t

    def victim(self, names: Sequence[str], _now_s: float) -> str | None:
        """Name of the next one, if it is time."""
        if not self._left or self._t < self._after:
            return None
        assert self._left[0] in names
        return self._left.pop(0)


@pytest.mark.parametrize(
    ("victims", "counted"),
    [(("allocator-0",), "stale"), (("planner-0", "planner-1"), "late"), (("recorder-0",), None)],
)
def test_every_dwell_is_transmitted_whoever_is_killed(
    victims: tuple[str, ...], counted: str | None, tmp_path: Path, process_names: Callable[[], list[str]]
) -> None:
    compile_all(lambda _: None)
    store = tmp_path / "run.db"
    start = smoke_start(dwells=DWELLS).model_copy(update={"rate_hz": RATE_HZ})
    sent: list[str] = []
    began, killer = time.monotonic(), Killer(victims, after=8)
    result = distributed.play(
        start,
        LocalProcesses(2, str(store), killer),
        report=killer.see,
        notify=sent.append,
        stop=threading.Event(),
    )
    assert time.monotonic() - began > DWELLS / RATE_HZ
    assert {name for name in victims if any(line.startswith(f"{name} ended") for line in sent)} == set(victims)
    assert (result.run["status"], result.run["t"]) == ("complete", DWELLS)
    found = rows(store, "SELECT payload FROM message WHERE topic = 'truth' ORDER BY k")
    truths = [decode(row["payload"]) for row in found]
    ks = [truth.k for truth in truths if isinstance(truth, Truth)]
    assert ks == list(range(len(ks)))
    assert [truth.t for truth in truths if isinstance(truth, Truth) and truth.t] == list(range(1, DWELLS + 1))
    if counted is not None:
        assert all(row[counted] > 0.0 for row in result.targets)
    assert all(row["n"] == DWELLS for row in result.targets)
    assert process_names() == []


# The bench: its search for a rate, its targets.


def _held_up_to(limit_hz: float) -> Callable[[float], Probe]:
    return lambda rate_hz: Probe(rate_hz, rate_hz, 0.0 if rate_hz <= limit_hz else 0.5, 0.0, 1.0)


@pytest.mark.parametrize("first_hz", [8.0, 20.0, 40.0])
def test_the_rate_is_found_between_one_that_is_held_and_one_that_is_not(first_hz: float) -> None:
    best, above_hz = highest_rate(_held_up_to(21.0), first_hz, lambda: True)
    assert best is not None
    assert best.rate_hz <= 21.0 < above_hz
    assert above_hz / best.rate_hz < bench_realtime.STEP


def test_a_search_for_a_rate_that_runs_out_of_time_keeps_what_it_has() -> None:
    best, above_hz = highest_rate(_held_up_to(21.0), 20.0, lambda: False)
    assert best is not None
    assert (best.rate_hz, above_hz) == (20.0, math.inf)
    assert highest_rate(_held_up_to(21.0), 40.0, lambda: False) == (None, 40.0)


@pytest.mark.parametrize(
    ("achieved_hz", "late", "stale", "held"),
    [(10.0, 0.009, 0.009, True), (10.0, 0.01, 0.0, False), (10.0, 0.0, 0.01, False), (9.8, 0.0, 0.0, False)],
)
def test_a_rate_is_held_if_plans_waveforms_and_the_emulator_are_in_time(
    achieved_hz: float, late: float, stale: float, held: bool
) -> None:
    assert Probe(10.0, achieved_hz, late, stale, 1.0).held is held


def test_a_cell_of_the_table_as_json() -> None:
    cell = Cell(3, 2, 50.0, Probe(20.0, 20.0, 0.0, 0.0, 0.5), math.inf)
    assert cell.as_json()["not_held_hz"] is None
    assert (cell.as_json()["targets"], cell.as_json()["rate_hz"], cell.as_json()["searched"]) == (3, 20.0, 0.5)
    assert "tracks" in bench_realtime.remark([cell, Cell(1, 1, 50.0, Probe(30.0, 30.0, 0.0, 0.0, 0.5), 40.0)])
    table = bench_realtime.table([cell, Cell(1, 1, 50.0, None, 40.0)])
    assert_shown_whole([table])
    assert [column.cell(table.rows[1]) for column in table.columns][2:4] == ["-", "40.0"]


@pytest.mark.parametrize("n_target", [1, 3, 10, 30, 75])
def test_the_targets_of_a_crowd_stay_in_bins_of_their_own(n_target: int) -> None:
    scenario = many_targets(n_target)
    states = scenario.simulated.initial_states()
    bins = angle_bin(spatial_frequency(states), scenario.radar.array.n_bin)
    assert len(set(bins.tolist())) == n_target == scenario.radar.tracks
    states[:, [0, 2]] += 300.0 * scenario.radar.motion.dt_s * states[:, [1, 3]]
    assert angle_bin(spatial_frequency(states), scenario.radar.array.n_bin).tolist() == bins.tolist()
