"""What a dwell radiated, over all directions, out of the stored waveform."""

import json
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from services.metrics.scores import Fields
from services.metrics.selection import ALL
from services.metrics.store import Store
from services.web.parameters import asked
from services.web.problems import bad, missing
from services.web.rows import headers_of, run_of, store_of, unchanged
from services.web.views.radar import angles_deg
from shared.protocol.messages import Waveform
from shared.signal.array import bin_centres
from shared.signal.waveform import beampattern as radiated
from shared.wire.codec import decode

POINTS = 2001  # over nu = -0.5 .. 0.5; ten on the main lobe of 200 antennas
FLOOR = 1e-12  # power, -120 dB


def beampattern(request: Request) -> Response:
    """Power a^T R a^* against direction in a dwell, relative to one watt spread evenly, and towards the beams."""
    parameters, name = asked(request, ("dwell",)), run_of(request)
    if name == ALL:
        raise bad("run = 'all': a beampattern is of one run")
    if answered := unchanged(request, name):
        return answered
    store, headers = store_of(request), headers_of(request, name)
    store.derive([name])
    t = parameters.get("dwell")
    return JSONResponse(of_dwell(store, name, None if t is None else int(t)), headers=headers)


def of_dwell(store: Store, run: str, t: int | None) -> dict[str, Any]:
    """The answer for a dwell of a run; None: the newest. Raises Problem."""
    table = store.table(run)
    rows = store.read(
        f"SELECT k, t, target, track, true_bin, hit, cells FROM {table} WHERE run = ?"
        f" AND t = COALESCE(?, (SELECT MAX(t) FROM {table} WHERE run = ?)) ORDER BY target",
        [run, t, run],
    )
    if not rows:
        ends = store.read(f"SELECT MIN(t) AS first, MAX(t) AS last FROM {table} WHERE run = ? HAVING MAX(t)", [run])
        there = f"there are {ends[0]['first']} to {ends[0]['last']}" if ends else "there is none yet, or no such run"
        raise missing(f"run = {run!r}: {f'no dwell {t}, ' if t is not None else ''}{there}")
    found = store.dwell(run, rows[0]["k"])
    truth = found["truth"]
    # Stale, if the front end says so; else the waveform of the dwell before.
    sent_k = truth[0]["waveform_k"] if truth else rows[0]["k"] - 1
    stored = store.read("SELECT payload FROM message WHERE run = ? AND k = ? AND topic = 'waveform'", [run, sent_k])
    waveform = decode(stored[0]["payload"]) if stored else None
    if not isinstance(waveform, Waveform):
        raise missing(f"run = {run!r}: the waveform of dwell {rows[0]['t']} is not stored")
    n_bin = store.read("SELECT json_extract(document, '$.radar.array.n_bin') AS n FROM run WHERE run = ?", [run])
    if not n_bin:  # dropped from the journal meanwhile; its messages go later
        raise missing(f"run = {run!r}: no such run")
    centres = bin_centres(n_bin[0]["n"])
    nus = np.linspace(-0.5, 0.5, POINTS)
    return {
        "run": run,
        "t": rows[0]["t"],
        "nu": nus.tolist(),
        "angle_deg": angles_deg(nus).tolist(),
        "power_db": _db(waveform, nus),
        "targets": [
            {
                "target": row["target"],
                "true_bin": row["true_bin"],
                "bin": bin_,
                "hit": None if row["hit"] is None else bool(row["hit"]),
                "nu": nu,
                "angle_deg": float(angles_deg(np.array(nu))),
                "power_db": _db(waveform, np.array([nu]))[0],
            }
            for row in rows
            for (bin_, _), nu in _lit(row, found["scan"], centres)  # none without a track, or if it had no beam
        ],
    }


def _lit(row: dict[str, Any], scans: list[Fields], centres: np.ndarray[Any, Any]) -> list[tuple[list[Any], float]]:
    """The cells that were lit for a track, bin and power, with their directions."""
    cells = json.loads(row["cells"])
    nus = centres[[bin_ for bin_, _ in cells]]
    if scans and cells and "beam_nus" in scans[0]:
        nus = scans[0]["beam_nus"][row["track"] - 1][: len(cells)]
    return list(zip(cells, nus.tolist(), strict=True))


def _db(waveform: Waveform, nus: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    power = radiated(waveform.isotropic, waveform.factor.astype(np.complex128), nus)
    levels: list[float] = (10.0 * np.log10(np.maximum(power, FLOOR))).tolist()
    return levels
