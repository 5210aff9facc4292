"""Shared services under load."""

import threading

import pytest

from cogradar.services.errors import RunFailed
from studies.processes import load
from tests.scenarios import varied
from tests.services.loop import SMOKE

DWELLS = 6


@pytest.mark.zenoh
def test_several_runs_at_once_are_timed(endpoint: str) -> None:
    notified: list[str] = []
    one, two = load.measure(endpoint, SMOKE, DWELLS, (1, 2), notified.append, threading.Event())
    assert notified == ["1 at once, 2 runs each", "2 at once, 2 runs each"]
    assert (one.at_once, two.at_once) == (1, 2)
    for found in (one, two):
        assert found.dwells_per_s == pytest.approx(DWELLS * found.runs_per_min / 60.0)
        assert 0.0 < found.dwell_ms <= found.dwell_99_ms < 60e3 / found.runs_per_min * found.at_once
    (row, _) = load.table([one, two]).rows
    assert row == load.as_json([one])[0]


@pytest.mark.zenoh
def test_a_run_that_fails_ends_the_load(endpoint: str) -> None:
    deaf = varied(SMOKE, {"echo": {"amplitude_db": -100.0}}, acquisition={"max_scans": 3})
    with pytest.raises(RunFailed, match="within 3 scans"):
        load.measure(endpoint, deaf, DWELLS, (2,), lambda _: None, threading.Event())


@pytest.mark.nightly
@pytest.mark.zenoh
def test_runs_with_certificates_are_timed_against_those_without() -> None:
    found = load.secured(SMOKE, DWELLS, 2, lambda _: None, threading.Event())
    assert 0.0 < found.low <= found.ratio <= found.high
    assert min(found.plain_ms, found.secured_ms) > 0.0
    (row,) = load.table_of_secured(found).rows
    assert row["ratio"] == found.ratio
