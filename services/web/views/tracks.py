"""The tracks of a dwell, for an unknown number of targets: by number, from the first dwell to the last."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.metrics.scoring.scorer import MessageFields
from cogradar.services.web.views.radar import Facts, angles_deg
from cogradar.shared.scoring.scan_rows import row_of_track

_STATE = ("x_hat", "vx_hat", "y_hat", "vy_hat")


def tracks_of(
    known: Facts,
    scan: MessageFields,
    sent: MessageFields | None,
    plans: Sequence[MessageFields],
    targets: Sequence[Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """The tracks that a scan looked at, each with what its plan says after that, and the target that it follows.

    sent : the waveform that was radiated, if it is stored
    targets : rows of `score`
    """
    planned = {plan["target"]: plan for plan in plans}
    followed = {row["track"]: row for row in targets if row["track"] is not None}
    return [
        track_of(known, scan, sent, track, (planned.get(track), followed.get(track + 1)))
        for track in scan["roster"]["ids"].tolist()
    ]


def track_of(
    known: Facts,
    scan: MessageFields,
    sent: MessageFields | None,
    track: int,
    after: tuple[MessageFields | None, Mapping[str, Any] | None],
) -> dict[str, Any]:
    """A track, counted from 0, that a scan looked at; after: its plan, and the row of the target that it follows."""
    (plan, target), roster = after, scan["roster"]
    row, at = row_of_track(scan, track), known.scan_rows.row_of_beam(scan, track)
    found = {
        "track": track + 1,
        "target": None if target is None else target["target"],
        "born_t": int(roster["born_k"][row]) + 1,
        "confirmed": bool(roster["confirmed"][row]),
        "statistic": None if at < 0 else float(scan["statistic"][at]),
        "threshold": None if at < 0 else float(known.scan_rows.read(scan).limits[at]),
        **_beams(known, scan, sent, track),
        **dict.fromkeys((*_STATE, "existence", "modes", "detected", "error_km", "covariance")),
        "is_over": False,
        "in_doubt": False,
    }
    if plan is None:
        return found
    found |= _planned(plan, target)
    if not found["detected"] and known.scan_rows.read(scan).is_unmeasured(row):
        found["detected"] = None
    return found


def _planned(plan: MessageFields, target: Mapping[str, Any] | None) -> dict[str, Any]:
    judged = {
        "confirmed": bool(plan["confirmed"]),
        "existence": plan["existence"],
        "modes": plan["modes"].tolist() if plan.get("modes") is not None else None,
        "detected": bool(plan["detected"]),
        "in_doubt": bool(plan.get("in_doubt")),
        "is_over": plan["status"] == "ended",
    }
    if judged["is_over"]:  # it says nothing of where
        return judged
    x, _, y, _ = plan["estimate"].tolist()
    is_known = target is not None and target["x"] is not None
    return {
        **dict(zip(_STATE, plan["estimate"].tolist(), strict=True)),
        **judged,
        "error_km": math.hypot(target["x"] - x, target["y"] - y) if is_known and target is not None else None,
        "covariance": plan["covariance"][[0, 0, 2], [0, 2, 2]].tolist(),
    }


def _beams(known: Facts, scan: MessageFields, sent: MessageFields | None, track: int) -> dict[str, Any]:
    """The beams of a track, brightest first, as far as its waveform is known with their power."""
    cells = lit(known, scan, sent, track)
    nus = np.array([nu for _, _, nu in cells])
    row = -1 if sent is None else row_of_track(sent, track)
    late = 0 if sent is None or row < 0 else sent["late"][row]
    return {
        **drawn(known, [(bin_, share) for bin_, share, _ in cells], nus),
        "share": sum(share for _, share, _ in cells),
        "late": bool(late),
    }


def lit(known: Facts, scan: MessageFields, sent: MessageFields | None, track: int) -> list[tuple[int, float, float]]:
    """Bin, power and direction of each beam of a track, brightest first; power 0 if the waveform is not known."""
    row = row_of_track(scan, track)
    if row < 0:
        return []
    at = -1 if sent is None else row_of_track(sent, track)
    beams = scan["beams"][row]
    shares = np.zeros(beams.size) if sent is None or at < 0 else sent["shares"][at]
    nus = scan["beam_nus"][row] if "beam_nus" in scan else known.centres[beams]
    found = zip(beams.tolist(), shares.tolist(), nus.tolist(), strict=True)
    return [(bin_, share, nu) for bin_, share, nu in found if bin_ >= 0]


def lit_for_target(
    row: Mapping[str, Any], scan: MessageFields | None, centres: NDArray[np.float64]
) -> tuple[list[tuple[int, float]], NDArray[np.float64]]:
    """The cells that were lit for a target's track, bin and power, brightest first, and their directions.

    row : of `score`; scan : None if it is not stored
    """
    cells = [(bin_, share) for bin_, share in json.loads(row["cells"])]
    if scan is not None and cells and "beam_nus" in scan:
        return cells, scan["beam_nus"][row_of_track(scan, row["track"] - 1)][: len(cells)]
    return cells, centres[[bin_ for bin_, _ in cells]]


def drawn(known: Facts, cells: Sequence[tuple[int, float]], nus: NDArray[np.float64]) -> dict[str, Any]:
    """Cells, brightest first, and where their beams are."""
    beam_deg = float(angles_deg(nus[0])) if cells else None
    return {"cells": cells, "beam_deg": beam_deg, "beams_deg": edges_deg(known, nus).tolist()}


def edges_deg(known: Facts, nus: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of beams in these directions, a bin wide, (n, 2), degrees."""
    half = 0.5 / (len(known.centres) - 1)
    return angles_deg(np.clip(np.stack((nus - half, nus + half), axis=-1), -0.5, 0.5))


def search_of(known: Facts, scan: MessageFields) -> dict[str, Any]:
    """Where new targets were searched for."""
    roster = scan["roster"]
    return {"beams_deg": edges_deg(known, roster["searched"]).tolist(), "share": roster["search_share"]}
