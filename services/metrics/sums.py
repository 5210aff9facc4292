"""Sums of scores over blocks of dwells: with them an answer about hundreds of thousands of dwells takes no time.

A block is the dwells of one run and target with the same t // SMALL, or t // BIG. It is always summed from its own rows
in their order: the same scores give the same bits, however they came. All targets of a run have the same dwells.
"""

import json
from collections.abc import Mapping

from services.recorder.journal import Journal

SMALL, BIG = 16, 512  # dwells of a block
RATIO = BIG // SMALL
WINDOW = 20  # rows before the end of a big block in which bin hits are counted apart: `shared.scoring.errors.lost`
UNKNOWN = 31  # in place of that number; above all that it can be
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
_OF_SUMS = ", ".join(f"SUM({name})" for name in _ROW)
_NAMES = ("target", "first_dwell", "last_dwell", *_ROW)


def create(journal: Journal) -> None:
    """Create the table of blocks, which belongs to this connection."""
    journal.create_temporary(
        "TABLE block (size INTEGER, run TEXT, target INTEGER, block INTEGER, first_dwell INTEGER, last_dwell INTEGER,"
        f" {', '.join(_ROW)}, last_hits INTEGER, PRIMARY KEY (size, run, target, block)) WITHOUT ROWID"
    )


def add(journal: Journal, table: str, run: str, first: int) -> None:
    """Sum the blocks of a run, whose scores are in this table, again from the one that holds dwell `first` on."""
    journal.write_temporary(
        f"INSERT OR REPLACE INTO temp.block SELECT {SMALL}, run, target, t / {SMALL}, MIN(t), MAX(t), {_OF_ROWS}, NULL"
        f" FROM {table} AS s WHERE run = ? AND t >= ? GROUP BY target, t / {SMALL}",
        [(run, first // SMALL * SMALL)],
    )
    journal.write_temporary(
        f"INSERT OR REPLACE INTO temp.block SELECT {BIG}, run, target, block / {RATIO}, MIN(first_dwell),"
        f" MAX(last_dwell), {_OF_SUMS}, NULL FROM temp.block"
        f" WHERE size = {SMALL} AND run = ? AND block >= ? GROUP BY target, block / {RATIO}",
        [(run, first // BIG * RATIO)],
    )
    journal.write_temporary(
        f"UPDATE temp.block SET last_hits = (SELECT SUM(hit) FROM (SELECT COALESCE(bin, -1) = true_bin AS hit"
        f" FROM {table} AS s WHERE s.run = block.run AND s.target = block.target AND t <= block.last_dwell"
        f" ORDER BY t DESC LIMIT {WINDOW})) WHERE size = {BIG} AND run = ? AND block >= ?",
        [(run, first // BIG)],
    )


def remove(journal: Journal, run: str) -> None:
    """Forget the blocks of a run."""
    journal.write_temporary("DELETE FROM temp.block WHERE run = ?", [(run,)])


def query(
    groups: Mapping[str, int], target: int | None, first: int | None, last: int | None
) -> tuple[str, tuple[str, ...]]:
    """A SELECT, and its values, of the sums over these dwells of each group of runs and each target.

    `groups` has the number of the group that each run is in. Columns: place (that number), target, runs, first_dwell,
    last_dwell, those of _ROW, and last_hits (UNKNOWN where it was not counted).
    """
    sums = ", ".join(f"SUM({name}) AS {name}" for name in _ROW)
    # Of the last block: no dwell is as late.
    last_hits = f"MAX(last_dwell * {UNKNOWN + 1} + COALESCE(last_hits, {UNKNOWN})) % {UNKNOWN + 1} AS last_hits"
    return (
        "SELECT place, target, COUNT(DISTINCT run) AS runs, MIN(first_dwell) AS first_dwell,"
        f" MAX(last_dwell) AS last_dwell, {sums}, {last_hits} FROM ({' UNION ALL '.join(_parts(target, first, last))})"
        " GROUP BY place, target ORDER BY place, target",
        (json.dumps(groups),),
    )


def _parts(target: int | None, first: int | None, last: int | None) -> list[str]:
    """What adds up to the dwells from `first` to `last`: big blocks; where one is cut small ones, and then scores."""
    a, b = first or 0, 2**31 if last is None else last
    chosen = f"FROM json_each(?1) AS chosen CROSS JOIN temp.block AS big ON big.size = {BIG} AND big.run = chosen.key"
    small = (
        f"{chosen} AND {_is_cut('big', a, b)} CROSS JOIN temp.block AS small ON small.size = {SMALL} AND"
        " small.run = big.run AND small.target = big.target AND"
        f" small.block BETWEEN big.block * {RATIO} AND big.block * {RATIO} + {RATIO - 1}"
    )

    def of(table: str) -> str:
        wanted = "" if target is None else f" AND {table}.target = {target}"
        return f"{_is_inside(table, a, b)}{wanted}"

    parts = [f"SELECT {_columns('big')}, big.last_hits {chosen} WHERE {of('big')}"]
    if (first, last) != (None, None):
        parts.append(f"SELECT {_columns('small')}, NULL {small} WHERE {of('small')}")
        wanted = "" if target is None else f" AND s.target = {target}"
        parts += [
            f"SELECT chosen.value, chosen.id, s.target, t, t, {', '.join(_ROW.values())}, NULL"
            f" {small} AND big.target = {TARGET} AND {_is_cut('small', a, b)}"
            f" CROSS JOIN {table} AS s ON s.run = small.run"
            f" AND t BETWEEN MAX(small.first_dwell, {a}) AND MIN(small.last_dwell, {b}){wanted}"
            for table in ("main.score", "temp.derived")
        ]
    return parts


def _columns(table: str) -> str:
    return ", ".join(["chosen.value AS place", "chosen.id AS run", *(f"{table}.{name}" for name in _NAMES)])


def _is_inside(table: str, a: int, b: int) -> str:
    return f"{table}.first_dwell >= {a} AND {table}.last_dwell <= {b}"


def _is_cut(table: str, a: int, b: int) -> str:
    overlaps = f"{table}.first_dwell <= {b} AND {table}.last_dwell >= {a}"
    return f"{overlaps} AND NOT ({_is_inside(table, a, b)})"
