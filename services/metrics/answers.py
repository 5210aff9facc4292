"""What can be asked of runs: METRICS. Targets count from 1.

Of a run without truth there are tracks, whose `detected` is that of the cell asked for; what needs truth is null.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from cogradar.services.errors import BadInput, Damaged
from cogradar.services.metrics.messages import command, commands, one_run, orders, page, refusal, utc
from cogradar.services.metrics.pools import confirmation, consistency
from cogradar.services.metrics.queries import messages
from cogradar.services.metrics.scoring import sums
from cogradar.services.metrics.scoring.antennas import AntennaPowers
from cogradar.services.metrics.selection import OLDEST_T, Run, Selection, selected, whole
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.store.seal import QUARANTINED
from cogradar.services.recorder.store.tables import ALL_ROWS
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scoring.columns import SCORE, SHOWN
from cogradar.shared.scoring.errors import LONG_OUTAGE, LOST_WINDOW, wilson_interval
from cogradar.shared.scoring.figures import Figures, Totals
from cogradar.shared.wire.codec import BadMessage, fields

Rows = list[dict[str, Any]]
# When a run began and ended, and how long it is by its own clock.
_CLOCKS = "began_s AS began, ended_s AS ended, acknowledged_t * dt_s AS length_s"
SILENT_S = 20.0  # without a word of the recorder: of a run that stands still it has one each 4 s, or 16 under load
# What a run that is held waits for.
NO_ROOM = "the journal: its disk is full, its file was removed, replaced or made read-only, or its server is away"


def answer(store: Store, metric: str, parameters: Mapping[str, str]) -> Rows:
    """Answer one query.

    Parameters: run, scenario, strategy, seed, target, dwells ("a:b", both included), limit and offset (of the rows).

    Without `run` the newest run that has begun to track is meant, of those that the other parameters allow; run = "all"
    means all of those, each once (`selection.selected`). `runs` is about all in any case. It and `picture` take no
    target and no dwells. Raises BadInput for an unknown metric, a bad parameter, runs, targets and dwells that there
    are not, and what cannot be known without truth.
    """
    if metric in _INTERNAL:
        return _INTERNAL[metric](store, parameters)
    if metric not in METRICS:
        raise BadInput(f"metric = {metric!r}: must be one of {', '.join(METRICS)}")
    if metric == "commands":
        return commands(store, parameters)
    selection = Selection.of(parameters)
    if metric == "runs":
        return _runs(store, selection)
    runs = selected(store, selection)
    store.derive(run["run"] for run in runs)
    if len(runs) == 1 and (name := runs[0]["run"]) in store.unreadable:
        raise BadInput(f"run = {name!r}: cannot be read: {store.unreadable[name]}")
    return _SCORED[metric](store, selection, runs)


def _sums(store: Store, selection: Selection, groups: Mapping[str, int]) -> Rows:
    """Sums per group and target. `groups` has the number of the group that each run is in."""
    return store.summed(*sums.query(groups, selection.target, selection.first, selection.last))


def _mean(row: dict[str, Any], name: str, over: str = "n") -> float | None:
    return None if row[name] is None or not row[over] else row[name] / row[over]


def _errors(row: dict[str, Any]) -> dict[str, float | None]:
    """Errors over the summed dwells with a track."""
    squares = {
        "position_rmse_km": _mean(row, "position", over="tracked"),
        "velocity_rmse_km_s": _mean(row, "velocity", over="tracked"),
    }
    return {name: None if square is None else math.sqrt(square) for name, square in squares.items()}


def _add_p_d(rows: Rows) -> Rows:
    """Rows with P_D and its Wilson interval, which takes dwells as independent; within a run they are not."""
    detections, n = (np.array([row[name] for row in rows], dtype=np.float64) for name in ("detections", "n"))
    ends = wilson_interval(detections, n)
    p_ds = detections / np.maximum(n, 1.0)
    for row, *values in zip(rows, p_ds.tolist(), *(end.tolist() for end in ends), strict=True):
        row |= dict(zip(("p_d", "p_d_low", "p_d_high"), values if row["n"] else 3 * [None], strict=True))
    return rows


def _runs(store: Store, selection: Selection) -> Rows:
    whole("runs", selection)
    condition, values = selection.of_runs
    query = (
        f"SELECT run, scenario, strategy, seed, NULLIF(dwells, {NO_END}) AS dwells, rate_hz, n_target AS targets,"
        " n_track AS tracks, NULL AS confirmed, acquisition_scans, conflicts, status, reason, NULL AS fault, digest,"
        f" acknowledged_t AS t, {OLDEST_T} AS oldest_t, {_CLOCKS},"
        f" NULL AS k FROM run WHERE {condition} ORDER BY place LIMIT ? OFFSET ?"
    )
    newest = "(SELECT k FROM message WHERE message.run = run.run AND topic = 'scan' ORDER BY k DESC LIMIT 1) AS k"
    values += [selection.most, selection.offset]
    try:
        rows, unread = store.read(query.replace("NULL AS k", newest), values), set[str]()
    except Damaged:  # messages of one run, and others are asked for with it
        rows = store.read(query, values)
        unread = {row["run"] for row in rows}
    damaged = store.damaged_rows(row["run"] for row in rows)
    for row in rows:
        row |= {"began": utc(row["began"]), "ended": utc(row["ended"])}
        try:
            if row["run"] in unread:
                query = "SELECT MAX(k) AS k FROM message WHERE run = ? AND topic = 'scan'"
                row["k"] = store.read(query, [row["run"]])[0]["k"]
            if row["run"] in damaged:
                raise damaged[row["run"]]
            store.damage([row["run"]])
        except Damaged as error:  # one run, and others are asked for with it
            row |= {"status": QUARANTINED, "reason": row["reason"] or str(error)}
    return [row | (_hindered(row, store) if row["status"] == "running" else {"waiting_for": ""}) for row in rows]


def _hindered(run: dict[str, Any], store: Store) -> dict[str, Any]:
    """What a run waits for, and what hinders it."""
    now = _now(store, run)
    if (silent_s := store.silent_s(run["run"], run["k"] or 0)) > SILENT_S and run["run"] not in store.held:
        now["waiting_for"] = f"the recorder, which has said nothing for {silent_s:.0f} s"
    fault = f"not measured: {now['fault']}" if now.get("fault") else ""
    return now | {"waiting_for": "; ".join(text for text in (now["waiting_for"], run["reason"], fault) if text)}


def count(store: Store, parameters: Mapping[str, str]) -> int:
    """How many rows `runs` has, without limit and offset. Raises BadInput."""
    condition, values = Selection.of(parameters).of_runs
    (row,) = store.read(f"SELECT COUNT(*) AS n FROM run WHERE {condition}", values)
    return int(row["n"])


def _now(store: Store, run: dict[str, Any]) -> dict[str, Any]:
    """Of a run that goes on: whose message the loop needs next, why nothing was measured in the newest dwell, and of an
    unknown number how many are confirmed.
    """
    if run["run"] in store.held:
        return {"waiting_for": NO_ROOM}
    if run["k"] is None:
        return {"waiting_for": "the emulator's first scan"}
    try:
        sent = store.stored("message", "WHERE run = ? AND k = ?", [run["run"], run["k"]])
        planned = {row["item"] for row in sent if row["topic"] == "plan"}
        (scan,) = (fields(row["payload"]) for row in sent if row["topic"] == "scan")
    except (BadMessage, Damaged) as error:  # one run, and others are asked for with it
        return {"waiting_for": f"scan of dwell {run['k']}: cannot be read: {error}"}
    tracks, found = list(range(1, 1 + (run["tracks"] or 0))), {"fault": scan.get("fault")}
    if run["tracks"] is None:
        roster = scan["roster"]
        tracks, found["confirmed"] = (roster["ids"] + 1).tolist(), int(roster["confirmed"].sum())
    missing = [str(track) for track in tracks if track not in planned]
    if missing:
        text = f"a planner: plan of track {', '.join(missing)} at dwell {run['k']}"
    elif all(row["topic"] != "waveform" for row in sent):
        text = f"the allocator: waveform of dwell {run['k']}"
    else:
        text = f"the emulator: scan of dwell {run['k'] + 1}"
    return found | {"waiting_for": text}


def _tracks(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per run, dwell and target; the runs before the page are counted, not read."""
    condition, values = selection.of_scores
    rows, skip, room = Rows(), selection.offset, selection.limit
    count = Counter[int]()
    if skip:
        for row in _sums(store, selection, {run["run"]: i for i, run in enumerate(runs)}):
            count[row["place"]] += row["scores"]
    for i, run in enumerate(runs):
        if skip and count[i] <= skip:
            skip -= count[i]
            continue
        found = store.scored(
            f"SELECT {', '.join(column.name for column in SHOWN)} FROM {store.table(run['run'])}"
            f" WHERE run = ? AND {condition} ORDER BY t, target LIMIT ? OFFSET ?",
            [run["run"], *values, ALL_ROWS if room is None else room - len(rows), skip],
        )
        of_run = {"run": run["run"], "strategy": run["strategy"]}
        rows += [{**of_run, **row, "cells": json.loads(row["cells"])} for row in found]
        skip = 0
        if room is not None and len(rows) >= room:
            break
    return rows


def _with_truth(metric: str, runs: list[Run]) -> list[Run]:
    """The runs with a known truth. Raises BadInput if there is none."""
    known = [run for run in runs if run["has_truth"]]
    if runs and not known:
        name = f"run = {runs[0]['run']!r}: has" if len(runs) == 1 else "these runs have"
        raise BadInput(f"{name} no truth to compare with, so {metric} is unknown; ask for tracks")
    return known


def _pooled(store: Store, metric: str, selection: Selection, runs: list[Run]) -> Rows:
    """Sums per experiment (scenario document and number of dwells), strategy and target.

    `place` is the number of experiment and strategy together.
    """
    known = _with_truth(metric, runs)
    kinds = sorted({(run["scenario"], run["dwells"], run["experiment"], run["strategy"]) for run in known})
    place = {(experiment, strategy): i for i, (_, _, experiment, strategy) in enumerate(kinds)}
    rows = _sums(store, selection, {run["run"]: place[run["experiment"], run["strategy"]] for run in known})
    for row in rows:
        row["scenario"], _, _, row["strategy"] = kinds[row["place"]]
    return rows


def _confirmation(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per experiment and strategy, of runs of an unknown number of targets."""
    whole("confirmation", selection)
    found = dict[tuple[Any, ...], list[Run]]()
    for run in _with_truth("confirmation", runs):
        if run["n_track"] is None:
            kind = tuple(run[name] for name in ("scenario", "dwells", "experiment", "strategy"))
            found.setdefault(kind, []).append(run)
    rows = [
        {"scenario": kind[0], "strategy": kind[-1], "runs": len(mine)} | confirmation(store, mine)._asdict()
        for kind, mine in sorted(found.items())
    ]
    return selection.page(rows)


LIFE = ("born_t", "gone_t", "visible_t", "confirmed_t")  # dwells of a target
_POOL = ("scenario", "strategy", "target", "runs", "first_dwell", "last_dwell", "n")


def _p_d(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    rows = selection.page(_pooled(store, "p_d", selection, runs))
    shown = (*_POOL, "detections")
    return _add_p_d([{name: row[name] for name in shown} | {"in_bin": _mean(row, "in_bin")} for row in rows])


def _rmse(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    rows = selection.page(_pooled(store, "rmse", selection, runs))
    return [{**{name: row[name] for name in _POOL}, **_errors(row)} for row in rows]


def _consistency(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per experiment, strategy and acceleration, over all targets that are asked about."""
    found = Rows()
    of_all = ("scenario", "strategy", "runs", "first_dwell", "last_dwell")
    for _, group in groupby(_pooled(store, "consistency", selection, runs), itemgetter("place")):
        rows = list(group)  # of the targets, which have the same runs and dwells
        found += [{name: rows[0][name] for name in of_all} | row for row in consistency(rows)]
    return selection.page(found)


def _summary(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per run and target: P_D, time in the bin, outages, errors, mean SNR, what came late, what was lost."""
    found, lost = Rows(), list[bool | None]()
    has_truth = {run["run"]: run["has_truth"] for run in runs}
    lives = {(row["run"], row["target"]): row for row in store.summed(*sums.lives(list(has_truth)))}
    for row in selection.page(_sums(store, selection, {run["run"]: i for i, run in enumerate(runs)})):
        run = runs[row["place"]]
        means = {name: _mean(row, name) for name in (column.name for column in SCORE if column.mean)}
        found.append(
            {
                "run": run["run"],
                **{name: row[name] for name in ("target", "first_dwell", "last_dwell", "n", "detections")},
                "hit_rate": _mean(row, "hits"),
                "in_bin": _mean(row, "in_bin"),
                "outage": row["out"],
                "outage_longest": row["outage_longest"],
                **means,
                **_errors(row),
                **{name: lives[run["run"], row["target"]][name] for name in LIFE},
                "tracked": row["tracked"] > 0,
                # Begun in this target's stead: it follows nothing. Of a target that none was begun for, `out` is None.
                "false_track": not row["tracked"] and row["out"] is not None,
            }
        )
        lost.append(_is_lost(row))
    for row, is_lost in zip(_add_p_d(found), lost, strict=True):
        row["lost"] = is_lost
        if not has_truth[row["run"]]:
            row.update(p_d=None, p_d_low=None, p_d_high=None)
    return found


def _is_lost(row: dict[str, Any]) -> bool | None:
    """Whether the track was lost in the dwells that were summed (`lost` of scoring.errors); None: there is none."""
    if row["out"] is None:
        return None
    return bool(row["last_outage"] >= min(LOST_WINDOW, row["followed"]) or row["outage_longest"] >= LONG_OUTAGE)


def _picture(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per run that has begun to track: all tracks and targets together (`cogradar.shared.scoring.picture`)."""
    whole("picture", selection)
    found = figures(store, [run["run"] for run in runs])
    of_run = ("run", "scenario", "strategy", "seed")
    begun = selection.page([run for run in runs if run["run"] in found])
    rows = [{name: run[name] for name in of_run} | found[run["run"]] for run in begun]
    return [row | {"unmeasured_fault": _last_fault(store, row)} for row in rows]


def _last_fault(store: Store, picture: dict[str, Any]) -> str | None:
    """Why nothing was measured in the last such dwell; None: there was none, or its scan is not kept."""
    if not picture["unmeasured_dwells"]:
        return None
    rows = store.scored(
        "SELECT k FROM picture WHERE run = ? AND unmeasured > 0 AND tested = 0 ORDER BY t DESC LIMIT 1",
        [picture["run"]],
    )
    scans = messages(store, picture["run"], "scan", [row["k"] for row in rows])
    return next((scan.get("fault") for scan in scans.values()), None)


def _antennas(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per run and transmit antenna, over the waveforms that are stored (`AntennaPowers`)."""
    if selection.target is not None:
        raise BadInput("`antennas` is about the array: it takes no target")
    found = Rows()
    for run in runs:
        of_run = {name: run[name] for name in ("run", "strategy")}
        rows = AntennaPowers.of(store, run["run"], selection.first, selection.last).rows()
        found += [of_run | row for row in rows]
    return selection.page(found)


def figures(store: Store, runs: list[str]) -> dict[str, dict[str, Any]]:
    """What the pictures of these runs come to, by run: `dwells`, the columns of `Figures`, and faults of cells."""
    return {row["run"]: _figures(row) for row in store.scored(*sums.picture(runs))}


def _figures(row: dict[str, Any]) -> dict[str, Any]:
    """Figures from sums; without truth only the number of tracks is known."""
    cells = {
        "blind_cells": row["blind"],
        "blind_dwells": row["blind_dwells"],
        "blind_share": _mean(row, "blind", "tested"),
        "unmeasured_looks": row["unmeasured"],
        "unmeasured_dwells": row["unmeasured_dwells"],
    }
    if row["established"] is None:
        return {"dwells": row["dwells"]} | dict.fromkeys(Figures._fields) | {"tracks": row["began"]} | cells
    total = Totals(*(row[name] for name in Totals._fields))
    return {"dwells": row["dwells"]} | Figures.of(total, row["dt_s"])._asdict() | cells


def _pictures(store: Store, parameters: Mapping[str, str]) -> Rows:
    """Rows of the table `picture` of one run, in the order of their dwells."""
    (run,) = one_run(store, parameters)
    store.derive([run["run"]])
    selection = Selection.of(parameters)
    return store.scored(
        "SELECT * FROM picture WHERE run = ? ORDER BY t LIMIT ? OFFSET ?",
        [run["run"], selection.most, selection.offset],
    )


_SCORED: dict[str, Callable[[Store, Selection, list[Run]], Rows]] = {
    "tracks": _tracks,
    "p_d": _p_d,
    "rmse": _rmse,
    "consistency": _consistency,
    "confirmation": _confirmation,
    "summary": _summary,
    "picture": _picture,
    "antennas": _antennas,
}
METRICS = ("runs", *_SCORED, "commands")
_INTERNAL: dict[str, Callable[[Store, Mapping[str, str]], Rows]] = {
    "one_run": one_run,
    "messages": page,
    "orders": orders,
    "pictures": _pictures,
    "command": command,
    "refusal": refusal,
}  # of our own programs
