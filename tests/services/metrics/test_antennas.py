"""Power and peak of the transmit antennas: what is asked is what the arrays of a run have."""

import numpy as np
import pytest

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.report import report
from cogradar.services.analysis.report_tables import tables
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.scoring.antennas import AntennaPowers
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs.in_process import play
from tests.services.loop import smoke_start

DWELLS = 20


@pytest.fixture(scope="module")
def store() -> Store:
    kept = in_memory()
    play(smoke_start(dwells=DWELLS), store=kept)
    return kept


@pytest.fixture(scope="module")
def result(store: Store) -> Result:
    return Result(StoredRun(lambda metric, asked: answer(store, metric, asked), None))


def test_rows_are_means_and_maxima_of_the_dwells_asked_for(store: Store, result: Result) -> None:
    rows = answer(store, "antennas", {"dwells": "3:12"})
    powers, papr_db = result.antenna_powers[2:12], result.papr_db[2:12]
    assert [row["antenna"] for row in rows] == list(range(1, 1 + powers.shape[1]))
    assert {(row["first_dwell"], row["last_dwell"], row["n"]) for row in rows} == {(3, 12, 10)}
    for name, expected in (
        ("power", powers.mean(axis=0)),
        ("power_max", powers.max(axis=0)),
        ("papr_db", papr_db.mean(axis=0)),
        ("papr_max_db", papr_db.max(axis=0)),
    ):
        np.testing.assert_allclose([row[name] for row in rows], expected, rtol=1e-9, atol=1e-9)
    assert sum(row["power"] for row in rows) == pytest.approx(result.scenario.radar.array.power)
    assert rows[4:6] == answer(store, "antennas", {"dwells": "3:12", "offset": "4", "limit": "2"})


def test_no_target_is_asked_for(store: Store) -> None:
    with pytest.raises(BadInput, match="takes no target"):
        answer(store, "antennas", {"target": "1"})


@pytest.mark.parametrize(
    ("most", "ts"), [(1, [1]), (4, [1, 6, 11, 16]), (7, [1, 4, 7, 10, 13, 16, 19]), (99, range(1, 21))]
)
def test_of_many_waveforms_some_at_equal_steps_are_taken(
    store: Store, result: Result, most: int, ts: list[int]
) -> None:
    found = AntennaPowers.of(store, result.run, None, None, most)
    assert found.ts.tolist() == list(ts)
    np.testing.assert_allclose(found.powers, result.antenna_powers[found.ts - 1])


def test_a_report_has_the_hottest_antenna_and_the_largest_peak(store: Store, result: Result) -> None:
    (experiment,) = experiments(store, Selection.of({}))
    made = report(store, experiment)
    (row,) = made["antennas"]
    ts = row_ts(DWELLS)
    powers = result.antenna_powers[ts - 1]
    assert row["n"] == ts.size
    assert row["hottest_db"] == pytest.approx(10.0 * np.log10(powers.max(axis=1) / powers.mean(axis=1)).mean())
    assert row["papr_db"] == pytest.approx(result.papr_db[ts - 1].max(axis=1).mean())
    (table,) = [table for table in tables(made) if table.title == "Transmit antennas, stored waveforms"]
    assert [column.heading for column in table.columns] == [
        "strategy", "waveforms", "hottest over mean, dB", "largest PAPR, dB"
    ]  # fmt: skip


def row_ts(dwells: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Every second dwell: 16 of a run at most."""
    return np.arange(1, dwells + 1, 2)
