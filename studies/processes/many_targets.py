"""The paper's radar with any number of targets."""

import numpy as np

from cogradar.shared.scenario.files import load, parse
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.signal.array import bin_centres

RANGES_KM = (20.0, 26.0, 32.0)  # of neighbours; near enough to be acquired within a few scans
SPEED_KM_S = 0.02  # away from the array, so that each target stays in its bin
MAX_NU = 0.4  # of the outermost; beyond, a bin is so wide that a track is uncertain for long


def many_targets(n_target: int) -> Scenario:
    """The paper's radar and `n_target` targets in bins of their own, evenly spread; at most 75."""
    paper = load("paper")
    nus = bin_centres(paper.radar.array.n_bin)
    inside = nus[np.abs(nus) <= MAX_NU]
    chosen = inside[np.linspace(0, inside.size - 1, n_target + 2).round().astype(int)[1:-1]]
    targets = []
    for m, nu in enumerate(chosen):
        sin, range_km = 2.0 * float(nu), RANGES_KM[m % len(RANGES_KM)]
        direction = np.array([(1.0 - sin**2) ** 0.5, sin])
        (x, y), (vx, vy) = (direction * range_km).tolist(), (direction * SPEED_KM_S).tolist()
        targets.append({"state": [x, vx, y, vy]})
    whole = paper.model_dump()
    whole |= {"name": f"targets-{n_target}", "radar": whole["radar"] | {"tracks": n_target}}
    return parse(whole | {"world": whole["world"] | {"targets": targets}}, source="many targets")
