"""What can be asked of runs: `runs`, `tracks`, `p_d`, `rmse`, `summary`. Targets count from 1, as in the paper.

Of a run without truth there are tracks, whose `detected` is that of the cell asked for; what needs truth is null.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from services.errors import BadInput
from services.metrics.recording import pack, take
from services.metrics.store import Store
from shared.scenario.radar_config import Strategy
from shared.scoring.errors import lost, wilson_interval

ALL = "all"  # as the name of a run: all runs together
MAX_DIGITS = 9  # of a number in a query
Rows = list[dict[str, Any]]


def answer(store: Store, metric: str, parameters: Mapping[str, str]) -> Rows:
    """Answer one query. Parameters: run, target, strategy, dwells ("a:b", both included).

    Without `run` the newest run that has begun to track is meant, of the strategy if one is given; run = "all" pools
    all of them. `runs` is about all in any case. Raises BadInput for an unknown metric or run, a bad parameter, a run
    without truth.
    """
    if metric not in METRICS:
        raise BadInput(f"metric = {metric!r}: must be one of {', '.join(METRICS)}")
    for name in parameters:
        if name not in {"run", "target", "strategy", "dwells"}:
            raise BadInput(f"{name}: unknown parameter, must be one of run, target, strategy, dwells")
    _where(parameters)
    if metric in {"runs", "recording"}:  # of all runs, or of the one that is named
        return METRICS[metric](store, parameters)
    if parameters.get("run") == ALL:
        asked = {name: value for name, value in parameters.items() if name != "run"}
        condition, values = _where({name: value for name, value in asked.items() if name == "strategy"})
        store.derive(row["run"] for row in store.read(f"SELECT run FROM run WHERE {condition}", values))
        return METRICS[metric](store, asked)
    run = parameters.get("run") or _newest(store, parameters)
    if run is None:
        return []
    store.derive([run])
    _check(store, metric, run, parameters.get("target", "1"))
    return METRICS[metric](store, {**parameters, "run": run})


def _newest(store: Store, parameters: Mapping[str, str]) -> str | None:
    condition, values = _where({name: value for name, value in parameters.items() if name == "strategy"})
    rows = store.read(
        f"SELECT run FROM run WHERE {condition} ORDER BY acknowledged_t > 0 DESC, rowid DESC LIMIT 1", values
    )
    return rows[0]["run"] if rows else None


def _check(store: Store, metric: str, run: str, target: str) -> None:
    """Refuse a question that cannot be answered of this run."""
    rows = store.read("SELECT has_truth, n_target FROM run WHERE run = ?", [run])
    if not rows:
        raise BadInput(f"run = {run!r}: no such run")
    if run in store.unreadable:
        raise BadInput(f"run = {run!r}: cannot be read: {store.unreadable[run]}")
    if metric in {"p_d", "rmse"} and not rows[0]["has_truth"]:
        raise BadInput(f"run = {run!r}: has no truth to compare with, so {metric} is unknown; ask for tracks")
    if int(target) > rows[0]["n_target"]:
        raise BadInput(f"target = {target}: run {run} has {rows[0]['n_target']} targets")


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


def _is_number(text: str) -> bool:
    return text.isdecimal() and len(text) <= MAX_DIGITS


def _where(parameters: Mapping[str, str]) -> tuple[str, list[Any]]:
    """SQL condition on `score JOIN run` for the parameters."""
    terms: list[str] = ["1"]
    values: list[Any] = []
    if "run" in parameters:
        terms.append("run = ?")
        values.append(parameters["run"])
    if "strategy" in parameters:
        if parameters["strategy"] not in set(Strategy):
            raise BadInput(f"strategy = {parameters['strategy']!r}: must be one of {', '.join(Strategy)}")
        terms.append("strategy = ?")
        values.append(parameters["strategy"])
    if "target" in parameters:
        if not _is_number(parameters["target"]) or int(parameters["target"]) < 1:
            raise BadInput(f"target = {parameters['target']!r}: must be a number from 1")
        terms.append("target = ?")
        values.append(int(parameters["target"]) - 1)
    if "dwells" in parameters:
        first, colon, last = parameters["dwells"].partition(":")
        if not colon or not all(part == "" or _is_number(part) for part in (first, last)):
            raise BadInput(f"dwells = {parameters['dwells']!r}: must be a:b, first and last dwell, either may be empty")
        if first and last and int(first) > int(last):
            raise BadInput(f"dwells = {parameters['dwells']!r}: the first must not be after the last")
        terms.append("t BETWEEN ? AND ?")
        values += [int(first or 0), int(last or 2**31)]
    return " AND ".join(terms), values


def _runs(store: Store, parameters: Mapping[str, str]) -> Rows:
    if unusable := set(parameters) - {"run", "strategy"}:
        raise BadInput(f"{min(unusable)}: `runs` takes run and strategy only")
    condition, values = _where(parameters)
    rows = store.read(
        "SELECT run, scenario, strategy, seed, dwells, rate_hz, n_target AS targets, acquisition_scans,"
        " conflicts, status, reason, digest, acknowledged_t AS t,"
        " (SELECT k FROM message WHERE message.run = run.run AND topic = 'scan' ORDER BY k DESC LIMIT 1) AS k"
        f" FROM run WHERE {condition} ORDER BY rowid",
        values,
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
    missing = [str(track + 1) for track in range(run["targets"]) if track not in planned]
    if missing:
        return f"a planner: plan of track {', '.join(missing)} at dwell {run['k']}"
    if all(row["topic"] != "waveform" for row in sent):
        return f"the allocator: waveform of dwell {run['k']}"
    return f"the emulator: scan of dwell {run['k'] + 1}"


def _tracks(store: Store, parameters: Mapping[str, str]) -> Rows:
    condition, values = _where(parameters)
    return store.read(
        "SELECT run, strategy, t, target + 1 AS target, true_bin, bin, detected, snr_db, x, vx, y, vy,"
        " x_hat, vx_hat, y_hat, vy_hat, share"
        f" FROM score JOIN run USING (run) WHERE {condition} ORDER BY run.rowid, t, target",
        values,
    )


def _grouped(store: Store, columns: str, parameters: Mapping[str, str]) -> Rows:
    condition, values = _where(parameters)
    return store.read(
        "SELECT strategy, target + 1 AS target, COUNT(DISTINCT run) AS runs,"
        " MIN(t) AS first_dwell, MAX(t) AS last_dwell,"
        f" COUNT(*) AS n, {columns} FROM score JOIN run USING (run) WHERE has_truth AND {condition}"
        " GROUP BY strategy, target ORDER BY strategy, target",
        values,
    )


def _p_d(store: Store, parameters: Mapping[str, str]) -> Rows:
    return _add_p_d(_grouped(store, "SUM(detected) AS detections", parameters))


def _rmse(store: Store, parameters: Mapping[str, str]) -> Rows:
    return _grouped(store, _ERRORS, parameters)


def _summary(store: Store, parameters: Mapping[str, str]) -> Rows:
    """One row per run and target: P_D, errors, bin-hit rate, mean SNR, what came late, whether the track was lost."""
    condition, values = _where(parameters)
    rows = store.read(
        "SELECT run, has_truth, target + 1 AS target, MIN(t) AS first_dwell, MAX(t) AS last_dwell, COUNT(*) AS n,"
        " SUM(detected) AS detections, AVG(bin = true_bin) AS hit_rate, AVG(snr_db) AS snr_db, AVG(share) AS share,"
        " AVG(late) AS late, AVG(stale) AS stale,"
        f" {_ERRORS} FROM score JOIN run USING (run) WHERE {condition} GROUP BY run, target ORDER BY run.rowid, target",
        values,
    )
    for row in _add_p_d(rows):
        if not row.pop("has_truth"):
            row.update(p_d=None, p_d_low=None, p_d_high=None, lost=None)
            continue
        in_bin = store.read(
            "SELECT bin = true_bin AS hit FROM score WHERE run = ? AND target = ? AND t BETWEEN ? AND ? ORDER BY t",
            [row["run"], row["target"] - 1, row["first_dwell"], row["last_dwell"]],
        )
        row["lost"] = bool(lost(np.array([bool(r["hit"]) for r in in_bin])))
    return rows


def _recording(store: Store, parameters: Mapping[str, str]) -> Rows:
    """What a campaign keeps of one run: its row, its scores, some of its waveforms."""
    if set(parameters) != {"run"}:
        raise BadInput("`recording` takes run, and nothing else")
    recording = take(store, parameters["run"])
    if recording is None:
        raise BadInput(f"run = {parameters['run']!r}: no such run")
    return [pack(recording)]


METRICS: dict[str, Callable[[Store, Mapping[str, str]], Rows]] = {
    "runs": _runs,
    "tracks": _tracks,
    "p_d": _p_d,
    "rmse": _rmse,
    "summary": _summary,
    "recording": _recording,
}
