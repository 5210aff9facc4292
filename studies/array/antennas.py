"""What equal antennas cost, against the optimum of the published program, which limits the sum of their powers."""

import time

import numpy as np

from cogradar.services.analysis.tables import Column, Row, Table
from cogradar.shared.power.equal_antennas import allocate_conventional, allocate_equal
from cogradar.shared.power.max_min import allocate
from cogradar.shared.signal.waveform import antenna_powers

N_TX, N_PROBLEM = 100, 100
TRACKS = (3, 12, 30)


def measure() -> list[Row]:
    """A row per number of tracks; directions anywhere, ranges of 10 to 100 km."""
    allocate_equal([0.1, 0.2], [1.0, 1.0], 1.0, N_TX)  # compiled
    return [_row(n_track) for n_track in TRACKS]


def _row(n_track: int) -> Row:
    losses, times = np.empty((N_PROBLEM, 4)), np.empty(N_PROBLEM)
    for seed in range(N_PROBLEM):
        rng = np.random.default_rng(seed)
        problem = rng.uniform(-0.49, 0.49, n_track), rng.uniform(10.0, 100.0, n_track) ** -4.0, 1.0, N_TX
        best, conventional = allocate(*problem), allocate_conventional(*problem)
        began = time.thread_time()
        equal = allocate_equal(*problem)
        times[seed] = time.thread_time() - began
        hottest = N_TX * antenna_powers(0.0, best.factor).max()
        ratios = best.value / equal.value, best.value / equal.bound, best.value / conventional.value, hottest
        losses[seed] = 10.0 * np.log10(ratios)
    mean, most = losses.mean(axis=0), losses.max(axis=0)
    row = {"tracks": n_track, "problems": N_PROBLEM, "ms": 1e3 * float(np.median(times))}
    for i, name in enumerate(("equal", "bound", "conventional", "scaled")):
        row |= {name: float(mean[i]), f"{name}_most": float(most[i])}
    return row


def table(rows: list[Row]) -> Table:
    def both(heading: str, name: str) -> Column:
        return Column(heading, f"{{{name}:.2f}}, {{{name}_most:.2f}}")

    columns = (
        Column("tracks", "{tracks}"),
        Column("problems", "{problems}"),
        both("equal antennas", "equal"),
        both("proven for any waveform with them", "bound"),
        both("conventional beams", "conventional"),
        both("the sum's optimum scaled down", "scaled"),
        Column("CPU ms", "{ms:.0f}"),
    )
    return Table("dB below the optimum of the sum: mean, most", columns, rows)
