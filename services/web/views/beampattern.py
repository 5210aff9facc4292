"""What a dwell radiated, over all directions, out of the stored waveform."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from cogradar.services.metrics import queries
from cogradar.services.metrics.scoring.scorer import MessageFields
from cogradar.services.metrics.store import Store
from cogradar.services.web.problem_documents import missing
from cogradar.services.web.run_answers import Question, about_run
from cogradar.services.web.views.radar import Facts, angles_deg, facts
from cogradar.services.web.views.tracks import lit
from cogradar.shared.scenario.radar_config import ArraySection
from cogradar.shared.scoring.scan_rows import tracks_in
from cogradar.shared.signal.waveform import antenna_powers, peak_to_average_db
from cogradar.shared.signal.waveform import beampattern as radiated

POINTS = 2001  # over nu = -0.5 .. 0.5; ten on the main lobe of 200 antennas
FLOOR = 1e-12  # power, -120 dB
Sent = tuple[float, np.ndarray[Any, np.dtype[np.complex128]]]  # power in all directions, and factor


@about_run("dwell")
def beampattern(_: Request, question: Question) -> Response:
    """Power a^T R a^* against direction in a dwell, relative to one watt spread evenly, and towards the beams."""
    known, t = facts(question.store, question.run), question.parameters.get("dwell")
    found = of_dwell(question.store, known, None if t is None else int(t))
    return JSONResponse(found, headers=question.headers)


def of_dwell(store: Store, known: Facts, t: int | None) -> dict[str, Any]:
    """The answer for a dwell of a run; None: the newest. Raises Problem."""
    run: str = known.row["run"]
    ends = queries.ends(store, run)
    at = t if t is not None or ends is None else ends[1]
    shown = [] if at is None else queries.pictures(store, run, at, at)
    if not shown:
        there = "there is none yet" if ends is None else f"there are {ends[0]} to {ends[1]}"
        raise missing(f"run = {run!r}: {f'no dwell {t}, ' if t is not None else ''}{there}")
    k, t = shown[0]["k"], shown[0]["t"]
    rows = queries.targets(store, run, t, t, ("target", "track", "true_bin", "hit"))
    scan = next(iter(store.dwell(run, k, ("scan",))["scan"]), None)
    waveform = _sent(store, run, shown[0]["waveform_k"], known.radar.array)
    if waveform is None:
        raise missing(f"run = {run!r}: the waveform of dwell {t} is not stored")
    roster: Mapping[str, Any] = {} if scan is None else scan.get("roster", {})
    nus = np.linspace(-0.5, 0.5, POINTS)
    return {
        "run": run,
        "t": t,
        "nu": nus.tolist(),
        "angle_deg": angles_deg(nus).tolist(),
        "power_db": _db(waveform, nus),
        "beams": [] if scan is None else _beams(known, waveform, scan, rows),
        "antennas": _antennas(waveform),
        "search": [_towards(waveform, float(nu)) for nu in roster.get("searched", ())],
    }


def _sent(store: Store, run: str, k: int, array: ArraySection) -> Sent | None:
    """Waveform k; None if it is not stored. Before the first one power goes in all directions."""
    if k < 0:
        return array.power, np.empty((array.n_tx, 0), dtype=np.complex128)
    found = store.dwell(run, k, ("waveform",))["waveform"]
    return (found[0]["isotropic"], found[0]["factor"].astype(np.complex128)) if found else None


def _beams(
    known: Facts, waveform: Sent, scan: MessageFields, rows: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """The beams of all tracks, each with what is known of the target that the track follows; rows: of `score`."""
    targets: dict[int, Mapping[str, Any]] = {row["track"]: row for row in rows}
    beams = []
    for track in tracks_in(scan).tolist():
        row = targets.get(track + 1, {})
        hit = row.get("hit")
        of_track = {
            "track": track + 1,
            "target": row.get("target"),
            "true_bin": row.get("true_bin"),
            "hit": None if hit is None else bool(hit),
        }
        beams += [of_track | {"bin": bin_, **_towards(waveform, nu)} for bin_, _, nu in lit(known, scan, None, track)]
    return beams


def _antennas(waveform: Sent) -> list[dict[str, Any]]:
    """Power of each transmit antenna, and its peak over the mean."""
    powers, peaks = antenna_powers(*waveform), peak_to_average_db(*waveform)
    return [
        {"antenna": i + 1, "power": power, "papr_db": papr_db}
        for i, (power, papr_db) in enumerate(zip(powers.tolist(), peaks.tolist(), strict=True))
    ]


def _towards(waveform: Sent, nu: float) -> dict[str, float]:
    """A direction and the power in it."""
    angle_deg = float(angles_deg(np.array(nu)))
    return {"nu": nu, "angle_deg": angle_deg, "power_db": _db(waveform, np.array([nu]))[0]}


def _db(waveform: Sent, nus: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    power = radiated(*waveform, nus)
    levels: list[float] = (10.0 * np.log10(np.maximum(power, FLOOR))).tolist()
    return levels
