"""Sums over blocks are the sums over the rows, whatever the dwells asked for and however the scores came."""

import json
import random
from typing import Any

import pytest

from cogradar.services.metrics.scoring import sums
from cogradar.services.metrics.store import DERIVED, KEPT, Store, in_memory
from cogradar.shared.scoring.columns import SCORE
from tests.services.loop import smoke_start

TARGETS = 2
N = {"short": 7, "gaps": 300, "long": 1100}  # dwells of the runs


def _rows(run: str, n: int) -> list[tuple[Any, ...]]:
    rng = random.Random(n)  # noqa: S311 - a test's own numbers
    dwells = [t for t in range(1, n + 1) if run != "gaps" or rng.random() < 0.9]
    return [
        (
            *(run, t + 9, t, target, target, 5, rng.choice([4, 5]), rng.random() < 0.9),
            *(rng.uniform(-9.0, 9.0) for _ in range(11)),
            *(1.0, rng.random() < 0.1, rng.random() < 0.1),
            *(rng.random() < 0.8, rng.choice([4, 5]), rng.choice([0, 0, 0, t]), rng.choice([4.0, 20.0, None])),
            *(2.0, rng.uniform(0.0, 9.0), rng.choice([None, 0.05, 0.5, 1.0, 2.9, 3.0]), True, "[]"),
        )
        for t in dwells
        for target in range(1, TARGETS + 1)
    ]


def _begun() -> Store:
    store = in_memory()
    for run in N:
        store.journal.add_run(smoke_start(run=run))
    store.journal.commit()
    return store


def _add(store: Store, table: str, rows: list[tuple[Any, ...]]) -> None:
    values = f"VALUES ({','.join('?' * len(rows[0]))})"
    store.journal.write_temporary(f"INSERT INTO {table} {values}", rows)
    sums.add(store.journal, table, rows[0][0], rows[0][2])


@pytest.fixture(scope="module", params=[KEPT, DERIVED])
def store(request: pytest.FixtureRequest) -> Store:
    """Three runs whose scores came in pieces."""
    store = _begun()
    rng = random.Random(1)  # noqa: S311 - a test's own numbers
    for run, n in N.items():
        rows = _rows(run, n)
        while rows:
            piece = TARGETS * rng.randrange(1, 80)
            _add(store, request.param, rows[:piece])
            rows = rows[piece:]
    return store


@pytest.mark.parametrize("target", [None, 2])
@pytest.mark.parametrize(
    ("first", "last"), [(None, None), (1, None), (None, 600), (32, 63), (33, 62), (3, 3), (2, 1099), (512, 1024)]
)
def test_sums_are_those_of_the_rows(store: Store, first: int | None, last: int | None, target: int | None) -> None:
    groups = {"short": 0, "gaps": 1, "long": 0}
    found = store.read(*sums.query(groups, target, first, last))
    rows = store.read(
        "SELECT *, (x - x_hat) * (x - x_hat) + (y - y_hat) * (y - y_hat) AS square FROM score"
        " JOIN json_each(?) ON key = run WHERE t BETWEEN ? AND ? AND (? IS NULL OR target = ?) ORDER BY run, t",
        [json.dumps(groups), first or 0, 9999 if last is None else last, target, target],
    )
    asked = [(g, m) for g in (0, 1) for m in range(1, TARGETS + 1) if m == (target or m)]
    expected = [[row for row in rows if (row["value"], row["target"]) == pair] for pair in asked]
    assert [(row["place"], row["target"]) for row in found] == [p for p, e in zip(asked, expected, strict=True) if e]
    for row, own in zip(found, filter(None, expected), strict=True):
        assert row["runs"] == len({r["run"] for r in own})
        assert (row["first_dwell"], row["last_dwell"]) == (min(r["t"] for r in own), max(r["t"] for r in own))
        assert (row["n"], row["detections"]) == (len(own), sum(r["detected"] for r in own))
        assert row["hits"] == sum(r["hit"] for r in own)
        assert row["in_bin"] == sum(r["best_bin"] == r["true_bin"] for r in own)
        assert row["out"] == sum(r["outage"] > 0 for r in own)
        assert row["outage_longest"] == max(r["outage"] for r in own)
        assert row["position"] == pytest.approx(sum(r["square"] for r in own), rel=1e-12)
        ends = ((-2.0, 99.0), (0.0, 0.1), (0.1, 1.0), (1.0, 3.0), (3.0, 99.0))  # -1: it is not known
        for columns, (low, high) in zip(sums.OF_FLIGHTS, ends, strict=True):
            known = [r for r in own if r["nees"] is not None]
            flown = [r for r in known if low <= (r["acceleration_g"] or -1.0) < high]
            n, nees, _, _, beyond = (row[name] or 0.0 for name in columns)
            assert (n, beyond) == (len(flown), sum(r["nees"] > 13.28 for r in flown))
            assert nees == pytest.approx(sum(r["nees"] for r in flown), rel=1e-9)
        assert row["snr_db"] == pytest.approx(sum(r["snr_db"] for r in own), rel=1e-9, abs=1e-9)


def test_the_same_scores_give_the_same_bits(store: Store) -> None:
    once = _begun()
    for run, n in N.items():
        _add(once, DERIVED, _rows(run, n))
    question = sums.query(dict.fromkeys(N, 0), None, None, None)
    assert once.read(*question) == store.read(*question)


def test_an_outage_of_weeks_is_told_as_it_is() -> None:
    """Of a run without an end, at 10 dwells a second: longer than 2^20 dwells."""
    store, names = _begun(), [column.name for column in SCORE]
    t, outage = names.index("t"), names.index("outage")
    first, outages = 2**31 - 100, (2**30, 2**30 + 1, 0)
    for lost in (outages, outages[:2]):
        run = "short" if lost is outages else "gaps"
        row = _rows(run, 1)[0]
        for i, length in enumerate(lost):
            found = [*row]
            found[t], found[outage] = first + i, length
            _add(store, DERIVED, [tuple(found)])
    rows = store.read(*sums.query({"short": 0, "gaps": 1}, 1, None, None))
    assert [(row["last_outage"], row["outage_longest"]) for row in rows] == [(0, 2**30 + 1), (2**30 + 1, 2**30 + 1)]
