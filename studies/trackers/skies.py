"""Skies that are made anew for each seed: scenario files by name."""

from collections.abc import Callable
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray

from cogradar.services.skies import files
from cogradar.services.skies.files import Sky, Target
from cogradar.services.skies.traffic import traffic
from cogradar.shared.numerics.constants import G_KM_S2

RANGE_KM = 100.0
DENSE, DENSE_S = 45, 600  # aircraft, and the seconds in which they come and go
SIX_S, FORMATION_S = 150, 150


def dense(seed: int) -> str:
    """Some twenty aircraft at once."""
    return _file(f"{DENSE} aircraft in {DENSE_S} s, seed {seed}", traffic(DENSE, DENSE_S, RANGE_KM, seed), DENSE_S)


def six(seed: int) -> str:
    """Six aircraft at once that turn with 2 to 9 g, one turn after another."""
    rng = np.random.default_rng(seed)
    return _file(f"Six aircraft that turn with up to 9 g, seed {seed}", [_turning(rng) for _ in range(6)], SIX_S)


def formation(seed: int) -> str:
    """Two aircraft 300 m apart across the line of sight, which split after two thirds."""
    rng = np.random.default_rng(seed)
    r, bearing, course = rng.uniform(35.0, 60.0), rng.uniform(-0.6, 0.6), rng.uniform(0.0, 2.0 * pi)
    split = {"from_s": FORMATION_S - 60.0, "to_s": FORMATION_S - 45.0}
    targets = [
        {
            "state": _rounded(
                r * cos(bearing) - aside * sin(bearing),
                0.22 * cos(course),
                r * sin(bearing) + aside * cos(bearing),
                0.22 * sin(course),
            ),
            "turns": [split | {"g": g}],
        }
        for aside, g in ((0.15, 2.0), (-0.15, -2.0))
    ]
    return _file(f"Two aircraft 300 m apart that split, seed {seed}", targets, FORMATION_S)


SKIES: dict[str, Callable[[int], str]] = {"dense": dense, "six": six, "formation": formation}


def _file(title: str, targets: list[Target], seconds: int) -> str:
    return files.text(Sky(title, "python -m studies trackers", targets, seconds, RANGE_KM))


def _turning(rng: np.random.Generator) -> Target:
    """An aircraft that stays between 20 and 90 km before the radar."""
    while True:
        speed, course = rng.uniform(0.2, 0.35), rng.uniform(0.0, 2.0 * pi)
        r, bearing = rng.uniform(30.0, 75.0), rng.uniform(-0.9, 0.9)
        turns, free_s = list[dict[str, float]](), rng.uniform(10.0, 25.0)
        while free_s < SIX_S - 10.0:
            g = rng.uniform(2.0, 9.0) * rng.choice((-1, 1))
            to_s = free_s + max(3.0, round(rng.uniform(0.5, 2.5) * speed / (abs(g) * G_KM_S2)))
            turns.append({"from_s": round(free_s), "to_s": round(to_s), "g": round(float(g), 2)})
            free_s = to_s + rng.uniform(8.0, 25.0)
        path = _path(r * np.exp(1j * bearing), speed * np.exp(1j * course), turns)
        if path.real.min() > 5.0 and abs(path).min() > 20.0 and abs(path).max() < 90.0:
            state = _rounded(path[0].real, speed * cos(course), path[0].imag, speed * sin(course))
            return {"state": state, "turns": turns}


def _path(place: complex, velocity: complex, turns: list[dict[str, float]]) -> NDArray[np.complex128]:
    """Places x + iy second by second; only to see where it leads."""
    found = [place]
    for t in range(SIX_S):
        g = sum(turn["g"] for turn in turns if turn["from_s"] <= t < turn["to_s"])
        angle = g * G_KM_S2 / abs(velocity)
        place, velocity = place + velocity * np.exp(0.5j * angle), velocity * np.exp(1j * angle)
        found.append(place)
    return np.array(found)


def _rounded(*values: float) -> list[float]:
    return [round(float(value), 4) for value in values]
