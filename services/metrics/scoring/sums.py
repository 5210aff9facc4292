"""Sums of scores over blocks of dwells: with them an answer about hundreds of thousands of dwells takes no time.

A block is the dwells of one run and target with the same t // DWELLS. It is always summed from its own rows in their
order: the same scores give the same bits, however they came. All targets of a run have the same dwells. Only dwells in
which a target is there are summed. If the number of tracks is unknown, they count from when a track has followed it
first.
"""

import json
from collections.abc import Mapping, Sequence
from math import isfinite

from cogradar.services.recorder.journal import Journal
from cogradar.shared.scoring.columns import SCORE
from cogradar.shared.scoring.errors import FLIGHTS, LOST_WINDOW, NEES_99, Flight
from cogradar.shared.scoring.figures import CUT_OFF_KM, Totals

DWELLS = 16  # of a block
TARGET = 1  # the first one
# Of a score s of a run r: its target is there, the dwell was measured where it is and, if the number of tracks is
# unknown, it was followed before or is now.
SCORED = "s.detected IS NOT NULL AND (s.outage IS NOT NULL OR r.n_track IS NOT NULL)"
_VELOCITY = "(s.vx - s.vx_hat) * (s.vx - s.vx_hat) + (s.vy - s.vy_hat) * (s.vy - s.vy_hat)"
_POSITION = "(s.x - s.x_hat) * (s.x - s.x_hat) + (s.y - s.y_hat) * (s.y - s.y_hat)"


def _flies(flight: Flight) -> str:
    """Whether a target flies so in the dwell of a score s."""
    ends = ((">=", flight.low_g), ("<", flight.high_g))
    return " AND ".join(f"s.acceleration_g {sign} {end}" for sign, end in ends if isfinite(end)) or "1"


# Of the dwells in which a target flies so: how many have a NEES, its sums, and how often it is beyond its 99 % bound.
CONSISTENCY = ("n", "nees", "nees_position", "nees_velocity", "beyond_99")
_CONSISTENCY = ("s.nees IS NOT NULL", "s.nees", "s.nees_position", "s.nees_velocity", f"s.nees > {NEES_99}")
OF_FLIGHTS = [[f"flight_{i}_{name}" for name in CONSISTENCY] for i in range(len(FLIGHTS))]  # columns of the sums
_ROW = {  # of a score s of a run r
    "scores": "1",
    "n": SCORED,
    "detections": f"{SCORED} AND s.detected",
    "tracked": f"{SCORED} AND s.track IS NOT NULL",
    "hits": f"CASE WHEN {SCORED} THEN s.hit END",
    # 0 of a target without a track, NULL without truth
    "in_bin": f"CASE WHEN {SCORED} THEN COALESCE(s.best_bin, -1) = s.true_bin END",
    # Whether it was measured or not: an outage of the receiver is none of the track's, and none ends by it.
    "followed": "s.outage IS NOT NULL",
    "out": "s.outage > 0",
    **{column.name: f"CASE WHEN {SCORED} THEN s.{column.name} END" for column in SCORE if column.mean},
    "visible": "s.visible",
    "position": f"CASE WHEN {SCORED} THEN {_POSITION} END",
    "velocity": f"CASE WHEN {SCORED} THEN {_VELOCITY} END",
    **{
        name: f"CASE WHEN {_flies(flight)} THEN {term} END"
        for flight, names in zip(FLIGHTS, OF_FLIGHTS, strict=True)
        for name, term in zip(names, _CONSISTENCY, strict=True)
    },
}
_LATER = 2**31  # more than any outage: of two dwells the later one has the larger sum
_MOST = {  # not summed: the largest
    "outage_longest": "s.outage",
    "last_outage": f"{_LATER} * s.t + s.outage",
    "there_t": "CASE WHEN s.true_bin IS NOT NULL THEN s.t END",
}
_LEAST = {  # ... and the smallest
    "born_t": _MOST["there_t"],
    "visible_t": "CASE WHEN s.visible THEN s.t END",
    "confirmed_t": f"CASE WHEN {_POSITION} < {CUT_OFF_KM**2} THEN s.t END",
}
_TERMS = _ROW | _MOST | _LEAST
_OF_ROWS = ", ".join(
    f"{function}({term})"
    for function, terms in (("SUM", _ROW), ("MAX", _MOST), ("MIN", _LEAST))
    for term in terms.values()
)
_NAMES = ("target", "first_dwell", "last_dwell", *_TERMS)
_WITH_RUN = "CROSS JOIN main.run AS r ON r.run = s.run"
# Whether a score's track is lost in its dwell; NULL without truth.
IS_LOST = f"outage >= MIN({LOST_WINDOW}, t)"


def create(journal: Journal) -> None:
    """Create the table of blocks, which belongs to this connection."""
    journal.create_temporary(
        "TABLE block (run TEXT, target INTEGER, block INTEGER, first_dwell INTEGER, last_dwell INTEGER,"
        f" {', '.join(_TERMS)}, PRIMARY KEY (run, target, block)) WITHOUT ROWID"
    )


def add(journal: Journal, table: str, run: str, first: int) -> None:
    """Sum the blocks of a run, whose scores are in this table, again from the one that holds dwell `first` on."""
    journal.write_temporary(
        f"INSERT OR REPLACE INTO temp.block SELECT s.run, target, t / {DWELLS}, MIN(t), MAX(t), {_OF_ROWS}"
        f" FROM {table} AS s {_WITH_RUN} WHERE s.run = ? AND t >= ? GROUP BY target, t / {DWELLS}",
        [(run, first // DWELLS * DWELLS)],
    )


def remove(journal: Journal, run: str) -> None:
    """Forget the blocks of a run."""
    journal.write_temporary("DELETE FROM temp.block WHERE run = ?", [(run,)])


def cut(journal: Journal, run: str, targets: int, before: int) -> None:
    """Forget the blocks before the one that holds dwell `before`."""
    rows = [(run, target, before // DWELLS) for target in range(TARGET, TARGET + targets)]
    journal.write_temporary("DELETE FROM temp.block WHERE run = ? AND target = ? AND block < ?", rows)


def query(
    groups: Mapping[str, int], target: int | None, first: int | None, last: int | None
) -> tuple[str, tuple[str, ...]]:
    """A SELECT, and its values, of the sums over these dwells of each group of runs and each target.

    `groups` has the number of the group that each run is in. Columns: place (that number), target, runs, first_dwell,
    last_dwell, and the columns of _TERMS; `last_outage` goes on in the last dwell.
    """
    most = {"outage_longest": "MAX(outage_longest)", "last_outage": f"MAX(last_outage) % {_LATER}"}
    sums = ", ".join(f"{most.get(name, f'SUM({name})')} AS {name}" for name in (*_ROW, *most))
    return (
        "SELECT place, target, COUNT(DISTINCT run) AS runs, MIN(first_dwell) AS first_dwell,"
        f" MAX(last_dwell) AS last_dwell, {sums} FROM ({' UNION ALL '.join(_parts(target, first, last))})"
        " GROUP BY place, target ORDER BY place, target",
        (json.dumps(groups),),
    )


def lives(runs: Sequence[str]) -> tuple[str, list[str]]:
    """A SELECT, and its values, of the dwells in which each target of these runs was there: `run`, `target`.

    Columns: born_t, the first one; gone_t, the one after the last, NULL while it is there; visible_t, the first one in
    which it could be found; visible, how many there were since then; confirmed_t, the first one with its track within
    the gate. All are NULL without truth.
    """
    return (
        "SELECT run, target, born_t, CASE WHEN there_t < MAX(last_dwell) OVER (PARTITION BY run) THEN there_t + 1 END"
        " AS gone_t, visible_t, visible, confirmed_t FROM (SELECT run, target, MIN(born_t) AS born_t,"
        " MAX(there_t) AS there_t, MIN(visible_t) AS visible_t, SUM(visible) AS visible,"
        " MIN(confirmed_t) AS confirmed_t, MAX(last_dwell) AS last_dwell FROM temp.block"
        " WHERE run IN (SELECT value FROM json_each(?)) GROUP BY run, target)",
        [json.dumps(runs)],
    )


def picture(runs: Sequence[str]) -> tuple[str, list[str]]:
    """A SELECT, and its values, of `Totals` of each of these runs, with `dt_s`. Without truth most are NULL.

    Besides: cells that were tested, blind ones, and dwells with a blind one; looks that were not measured, and
    dwells in which nothing was.
    """
    terms = ", ".join(f"SUM({name}) AS {name}" for name in Totals._fields[1:])
    return (
        "SELECT run, (SELECT dt_s FROM run WHERE run.run = picture.run) AS dt_s, COUNT(*) AS dwells,"
        " SUM(tested) AS tested, SUM(blind) AS blind, SUM(blind > 0) AS blind_dwells,"
        " SUM(unmeasured) AS unmeasured, SUM(unmeasured > 0 AND tested = 0) AS unmeasured_dwells,"
        f" {terms} FROM picture WHERE run IN (SELECT value FROM json_each(?)) GROUP BY run",
        [json.dumps(runs)],
    )


def lost(run: str, table: str, t: int) -> tuple[str, list[str | int]]:
    """A SELECT, and its values, of how many tracks are `lost` in a dwell. All scores of the run are in this table."""
    return f"SELECT SUM({IS_LOST}) AS lost FROM {table} WHERE run = ? AND t = ?", [run, t]


def timeline(run: str, table: str, width: int) -> tuple[str, list[str]]:
    """A SELECT, and its values, of what a run came to, by the bucket t // width of its dwells.

    `width` is a multiple of DWELLS, or the scores are read one by one, from this table. Columns: first and last dwell,
    `detected` (share of the targets), `lost` (tracks out of their target's bin in most of the bucket's dwells; without
    blocks those that are lost in its last one), `late` (plans), `stale` (dwells), error_km (largest root mean
    square).
    """
    if width % DWELLS:
        terms = ", ".join(f"{term} AS {name}" for name, term in _ROW.items())
        rows = (
            f"SELECT t / {width} AS bucket, target, t AS first, t AS last, {terms}, {IS_LOST} AS is_lost"
            f" FROM {table} AS s {_WITH_RUN} WHERE s.run = ?"
        )
        lost = "MAX(2 * last + is_lost) % 2"  # of the last dwell
    else:
        rows = (
            f"SELECT block / {width // DWELLS} AS bucket, target, first_dwell AS first, last_dwell AS last,"
            f" {', '.join(_ROW)} FROM temp.block WHERE run = ?"
        )
        lost = "2 * SUM(out) > SUM(followed)"
    of_targets = (
        "SELECT bucket, MIN(first) AS first, MAX(last) AS last, SUM(detections) AS detections, SUM(n) AS n,"
        f" {lost} AS lost, SUM(late) AS late, SUM(stale) AS stale, SUM(position) / SUM(tracked) AS position"
        f" FROM ({rows}) GROUP BY bucket, target"
    )
    return (
        "SELECT MIN(first) AS first, MAX(last) AS last, 1.0 * SUM(detections) / SUM(n) AS detected, SUM(lost) AS lost,"
        " COALESCE(SUM(late), 0) AS late, MAX(stale) AS stale, sqrt(MAX(position)) AS error_km"
        f" FROM ({of_targets}) GROUP BY bucket ORDER BY bucket",
        [run],
    )


def _parts(target: int | None, first: int | None, last: int | None) -> list[str]:
    """What adds up to the dwells from `first` to `last`: blocks, and where one is cut its scores."""
    a, b = first or 0, 2**31 if last is None else last
    chosen = "FROM json_each(?1) AS chosen CROSS JOIN temp.block AS block ON block.run = chosen.key"
    is_inside = f"block.first_dwell >= {a} AND block.last_dwell <= {b}"
    wanted = f">= {TARGET}" if target is None else f"= {target}"
    columns = ", ".join(f"block.{name}" for name in _NAMES)
    whole = f"{is_inside} AND block.target {wanted}"
    parts = [f"SELECT chosen.value AS place, chosen.id AS run, {columns} {chosen} WHERE {whole}"]
    if (first, last) != (None, None):
        parts += [
            f"SELECT chosen.value, chosen.id, s.target, t, t, {', '.join(_TERMS.values())} {chosen}"
            f" AND block.target = {TARGET} AND block.first_dwell <= {b} AND block.last_dwell >= {a}"
            f" AND NOT ({is_inside}) CROSS JOIN {table} AS s ON s.run = block.run"
            f" AND t BETWEEN MAX(block.first_dwell, {a}) AND MIN(block.last_dwell, {b}) AND s.target {wanted}"
            f" {_WITH_RUN}"
            for table in ("main.score", "temp.derived")
        ]
    return parts
