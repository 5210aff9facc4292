"""Sums of scores over blocks of dwells: with them an answer about hundreds of thousands of dwells takes no time.

A block is the dwells of one run and target with the same t // DWELLS. It is always summed from its own rows in their
order: the same scores give the same bits, however they came. All targets of a run have the same dwells.
"""

import json
from collections.abc import Mapping

from services.recorder.journal import Journal
from shared.scoring.errors import LOST_WINDOW

DWELLS = 16  # of a block
TARGET = 1  # the first one

_ROW = {  # of a score s
    "n": "1",
    "detections": "s.detected",
    "tracked": "s.track IS NOT NULL",
    "hits": "COALESCE(s.bin, -1) = s.true_bin",  # 0 of a target without a track, NULL without truth
    "snr_db": "s.snr_db",
    "share": "s.share",
    "late": "s.late",
    "stale": "s.stale",
    "position": "(s.x - s.x_hat) * (s.x - s.x_hat) + (s.y - s.y_hat) * (s.y - s.y_hat)",
    "velocity": "(s.vx - s.vx_hat) * (s.vx - s.vx_hat) + (s.vy - s.vy_hat) * (s.vy - s.vy_hat)",
}
_OF_ROWS = ", ".join(f"SUM({term})" for term in _ROW.values())
_NAMES = ("target", "first_dwell", "last_dwell", *_ROW)
# Whether each score's track was lost, as `shared.scoring.errors.lost` has it; NULL without truth.
_IS_LOST = f"2 * SUM({_ROW['hits']}) OVER recent < COUNT(*) OVER recent AS is_lost"
_RECENT = f"WINDOW recent AS (PARTITION BY target ORDER BY t ROWS {LOST_WINDOW - 1} PRECEDING)"


def create(journal: Journal) -> None:
    """Create the table of blocks, which belongs to this connection."""
    journal.create_temporary(
        "TABLE block (run TEXT, target INTEGER, block INTEGER, first_dwell INTEGER, last_dwell INTEGER,"
        f" {', '.join(_ROW)}, PRIMARY KEY (run, target, block)) WITHOUT ROWID"
    )


def add(journal: Journal, table: str, run: str, first: int) -> None:
    """Sum the blocks of a run, whose scores are in this table, again from the one that holds dwell `first` on."""
    journal.write_temporary(
        f"INSERT OR REPLACE INTO temp.block SELECT run, target, t / {DWELLS}, MIN(t), MAX(t), {_OF_ROWS}"
        f" FROM {table} AS s WHERE run = ? AND t >= ? GROUP BY target, t / {DWELLS}",
        [(run, first // DWELLS * DWELLS)],
    )


def remove(journal: Journal, run: str) -> None:
    """Forget the blocks of a run."""
    journal.write_temporary("DELETE FROM temp.block WHERE run = ?", [(run,)])


def query(
    groups: Mapping[str, int], target: int | None, first: int | None, last: int | None
) -> tuple[str, tuple[str, ...]]:
    """A SELECT, and its values, of the sums over these dwells of each group of runs and each target.

    `groups` has the number of the group that each run is in. Columns: place (that number), target, runs, first_dwell,
    last_dwell, and those of _ROW.
    """
    sums = ", ".join(f"SUM({name}) AS {name}" for name in _ROW)
    return (
        "SELECT place, target, COUNT(DISTINCT run) AS runs, MIN(first_dwell) AS first_dwell,"
        f" MAX(last_dwell) AS last_dwell, {sums} FROM ({' UNION ALL '.join(_parts(target, first, last))})"
        " GROUP BY place, target ORDER BY place, target",
        (json.dumps(groups),),
    )


def lost(run: str, table: str, first: int, last: int) -> tuple[str, list[str | int]]:
    """A SELECT, and its values, of what was lost at each of these dwells, by the LOST_WINDOW dwells up to it.

    Columns: t, target, is_lost. All scores of the run are in this table.
    """
    before = (
        f"SELECT MIN(t) FROM (SELECT t FROM {table} WHERE run = ?1 AND target = {TARGET} AND t <= ?2"
        f" ORDER BY t DESC LIMIT {LOST_WINDOW})"
    )
    rows = (
        f"SELECT t, target, {_IS_LOST} FROM {table} AS s WHERE run = ?1 AND t BETWEEN COALESCE(({before}), ?2) AND ?3"
        f" {_RECENT}"
    )
    return f"SELECT t, target, is_lost FROM ({rows}) WHERE t >= ?2", [run, first, last]


def timeline(run: str, table: str, width: int) -> tuple[str, list[str]]:
    """A SELECT, and its values, of what a run came to, by the bucket t // width of its dwells.

    `width` is a multiple of DWELLS, or the scores are read one by one, from this table. Columns: first and last dwell,
    `detected` (share of the targets), `lost` (tracks out of their target's bin in most of the bucket's dwells; without
    blocks of the LOST_WINDOW dwells up to its last one), `late` (plans), `stale` (dwells), error_km (largest root mean
    square).
    """
    if width % DWELLS:
        terms = ", ".join(f"{term} AS {name}" for name, term in _ROW.items())
        rows = (
            f"SELECT t / {width} AS bucket, target, t AS first, t AS last, {terms}, {_IS_LOST} FROM {table} AS s"
            f" WHERE run = ? {_RECENT}"
        )
        lost = "MAX(2 * last + is_lost) % 2"  # of the last dwell
    else:
        rows = (
            f"SELECT block / {width // DWELLS} AS bucket, target, first_dwell AS first, last_dwell AS last,"
            f" {', '.join(_ROW)} FROM temp.block WHERE run = ?"
        )
        lost = "2 * SUM(hits) < SUM(n)"
    of_targets = (
        "SELECT bucket, MIN(first) AS first, MAX(last) AS last, SUM(detections) AS detections, SUM(n) AS n,"
        f" {lost} AS lost, SUM(late) AS late, SUM(stale) AS stale, SUM(position) / SUM(tracked) AS position"
        f" FROM ({rows}) GROUP BY bucket, target"
    )
    return (
        "SELECT MIN(first) AS first, MAX(last) AS last, 1.0 * SUM(detections) / SUM(n) AS detected, SUM(lost) AS lost,"
        " SUM(late) AS late, MAX(stale) AS stale, sqrt(MAX(position)) AS error_km"
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
            f"SELECT chosen.value, chosen.id, s.target, t, t, {', '.join(_ROW.values())} {chosen}"
            f" AND block.target = {TARGET} AND block.first_dwell <= {b} AND block.last_dwell >= {a}"
            f" AND NOT ({is_inside}) CROSS JOIN {table} AS s ON s.run = block.run"
            f" AND t BETWEEN MAX(block.first_dwell, {a}) AND MIN(block.last_dwell, {b}) AND s.target {wanted}"
            for table in ("main.score", "temp.derived")
        ]
    return parts
