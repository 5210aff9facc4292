"""What can be asked of runs: `runs`, `tracks`, `p_d`, `rmse`, `summary`. Targets count from 1, as in the paper.

Of a run without truth there are tracks, whose `detected` is that of the cell asked for; what needs truth is null.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from services.errors import BadInput
from services.metrics.messages import one_run, page
from services.metrics.recording import pack, take
from services.metrics.selection import Run, Selection, selected
from services.metrics.store import Store
from shared.scoring.errors import lost, wilson_interval

Rows = list[dict[str, Any]]


def answer(store: Store, metric: str, parameters: Mapping[str, str]) -> Rows:
    """Answer one query.

    Parameters: run, scenario, strategy, seed, target, dwells ("a:b", both included), limit and offset (of the rows).

    Without `run` the newest run that has begun to track is meant, of those that the other parameters allow; run = "all"
    means all of those, each once (`selection.selected`). `runs` is about all in any case, and takes no target and no
    dwells. Raises BadInput for an unknown metric, a bad parameter, runs, targets and dwells that there are not, and
    what cannot be known without truth.
    """
    if metric in _INTERNAL:
        return _INTERNAL[metric](store, parameters)
    if metric not in METRICS:
        raise BadInput(f"metric = {metric!r}: must be one of {', '.join(METRICS)}")
    selection = Selection.of(parameters)
    if metric == "runs":
        return _runs(store, selection)
    runs = selected(store, selection)
    store.derive(run["run"] for run in runs)
    if len(runs) == 1 and (name := runs[0]["run"]) in store.unreadable:
        raise BadInput(f"run = {name!r}: cannot be read: {store.unreadable[name]}")
    return _SCORED[metric](store, selection, runs)


_ERRORS = (
    "SQRT(AVG((x - x_hat) * (x - x_hat) + (y - y_hat) * (y - y_hat))) AS position_rmse_km,"
    " SQRT(AVG((vx - vx_hat) * (vx - vx_hat) + (vy - vy_hat) * (vy - vy_hat))) AS velocity_rmse_km_s"
)


def _add_p_d(rows: Rows) -> Rows:
    """Rows with P_D and its Wilson interval, which takes dwells as independent; within a run they are not."""
    for row in rows:
        row["p_d"] = row["detections"] / row["n"]
        row["p_d_low"], row["p_d_high"] = map(float, wilson_interval(row["detections"], row["n"]))
    return rows


def _runs(store: Store, selection: Selection) -> Rows:
    if selection.target is not None or selection.first is not None or selection.last is not None:
        raise BadInput("`runs` is about whole runs: it takes no target and no dwells")
    condition, values = selection.of_runs
    rows = store.read(
        "SELECT run, scenario, strategy, seed, dwells, rate_hz, n_target AS targets, acquisition_scans,"
        " conflicts, status, reason, digest, acknowledged_t AS t,"
        " (SELECT k FROM message WHERE message.run = run.run AND topic = 'scan' ORDER BY k DESC LIMIT 1) AS k"
        f" FROM run WHERE {condition} ORDER BY rowid LIMIT ? OFFSET ?",
        [*values, -1 if selection.limit is None else selection.limit, selection.offset],
    )
    for row in rows:
        row["waiting_for"] = _waiting_for(store, row) if row["status"] == "running" else ""
    return rows


def _waiting_for(store: Store, run: dict[str, Any]) -> str:
    """Whose message the loop needs next."""
    if run["k"] is None:
        return "the emulator's first scan"
    sent = store.read("SELECT topic, item FROM message WHERE run = ? AND k = ?", [run["run"], run["k"]])
    planned = {row["item"] for row in sent if row["topic"] == "plan"}
    missing = [str(track) for track in range(1, run["targets"] + 1) if track not in planned]
    if missing:
        return f"a planner: plan of track {', '.join(missing)} at dwell {run['k']}"
    if all(row["topic"] != "waveform" for row in sent):
        return f"the allocator: waveform of dwell {run['k']}"
    return f"the emulator: scan of dwell {run['k'] + 1}"


def _tracks(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per run, dwell and target; the runs before the page are counted, not read."""
    condition, values = selection.of_scores
    rows, skip, room = Rows(), selection.offset, selection.limit
    for run in runs:
        if skip:
            (count,) = store.read(
                f"SELECT COUNT(*) AS n FROM score WHERE run = ? AND {condition}", [run["run"], *values]
            )
            if count["n"] <= skip:
                skip -= count["n"]
                continue
        found = store.read(
            "SELECT run, k, t, target, track, true_bin, bin, detected, snr_db, x, vx, y, vy, x_hat, vx_hat, y_hat,"
            f" vy_hat, share, late, stale FROM score WHERE run = ? AND {condition} ORDER BY t, target LIMIT ? OFFSET ?",
            [run["run"], *values, -1 if room is None else room - len(rows), skip],
        )
        rows += [{"run": run["run"], "strategy": run["strategy"], **row} for row in found]
        skip = 0
        if room is not None and len(rows) >= room:
            break
    return rows


def _grouped(store: Store, columns: str, selection: Selection, groups: Mapping[str, int]) -> Rows:
    """Rows of `columns` per group and target. `groups` has the number of the group that each run is in."""
    condition, values = selection.of_scores
    return store.read(
        "SELECT chosen.value AS place, target, COUNT(DISTINCT run) AS runs, MIN(t) AS first_dwell,"
        f" MAX(t) AS last_dwell, COUNT(*) AS n, {columns} FROM json_each(?) AS chosen"
        f" CROSS JOIN score ON score.run = chosen.key WHERE {condition} GROUP BY place, target ORDER BY place, target",
        [json.dumps(groups), *values],
    )


def _pooled(store: Store, metric: str, columns: str, selection: Selection, runs: list[Run]) -> Rows:
    """Rows of `columns` per experiment (scenario document and number of dwells), strategy and target."""
    known = [run for run in runs if run["has_truth"]]
    if runs and not known:
        name = f"run = {runs[0]['run']!r}: has" if len(runs) == 1 else "these runs have"
        raise BadInput(f"{name} no truth to compare with, so {metric} is unknown; ask for tracks")
    kinds = sorted({(run["scenario"], run["dwells"], run["experiment"], run["strategy"]) for run in known})
    place = {(experiment, strategy): i for i, (_, _, experiment, strategy) in enumerate(kinds)}
    rows = _grouped(store, columns, selection, {run["run"]: place[run["experiment"], run["strategy"]] for run in known})
    for i, row in enumerate(rows):
        scenario, _, _, strategy = kinds[row.pop("place")]
        rows[i] = {"scenario": scenario, "strategy": strategy, **row}
    return rows


def _p_d(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    return selection.page(_add_p_d(_pooled(store, "p_d", "SUM(detected) AS detections", selection, runs)))


def _rmse(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    return selection.page(_pooled(store, "rmse", _ERRORS, selection, runs))


def _summary(store: Store, selection: Selection, runs: list[Run]) -> Rows:
    """One row per run and target: P_D, errors, bin-hit rate, mean SNR, what came late, whether the track was lost."""
    columns = (
        "SUM(detected) AS detections, AVG(snr_db) AS snr_db, AVG(share) AS share,"
        " AVG(CASE WHEN true_bin IS NOT NULL THEN COALESCE(bin = true_bin, 0) END) AS hit_rate,"
        f" AVG(late) AS late, AVG(stale) AS stale, MAX(track IS NULL) AS false_track, {_ERRORS}"
    )
    rows = _grouped(store, columns, selection, {run["run"]: i for i, run in enumerate(runs)})
    found = Rows()
    for group in _add_p_d(selection.page(rows)):
        run = runs[group.pop("place")]
        del group["runs"]
        # The track that began in this target's stead follows nothing: its target is not tracked.
        row = {"run": run["run"], **group, "false_track": bool(group["false_track"])}
        found.append(row)
        if not run["has_truth"]:
            row.update(p_d=None, p_d_low=None, p_d_high=None, lost=None)
            continue
        in_bin = store.read(
            "SELECT bin = true_bin AS hit FROM score WHERE run = ? AND target = ? AND t BETWEEN ? AND ? ORDER BY t",
            [row["run"], row["target"], row["first_dwell"], row["last_dwell"]],
        )
        row["lost"] = bool(lost(np.array([bool(r["hit"]) for r in in_bin])))
    return found


def _recording(store: Store, parameters: Mapping[str, str]) -> Rows:
    """What a campaign keeps of one run: its row, its scores, some of its waveforms."""
    if set(parameters) != {"run"}:
        raise BadInput("`recording` takes run, and nothing else")
    recording = take(store, parameters["run"])
    if recording is None:
        raise BadInput(f"run = {parameters['run']!r}: no such run")
    return [pack(recording)]


_SCORED: dict[str, Callable[[Store, Selection, list[Run]], Rows]] = {
    "tracks": _tracks,
    "p_d": _p_d,
    "rmse": _rmse,
    "summary": _summary,
}
METRICS = ("runs", *_SCORED)
_INTERNAL: dict[str, Callable[[Store, Mapping[str, str]], Rows]] = {
    "recording": _recording,
    "one_run": one_run,
    "messages": page,
}  # of our own programs
