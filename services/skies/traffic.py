"""Made-up traffic: aircraft that arrive at random, follow airways, turn, and leave.

Arrivals are a Poisson process that has gone on for ever. Given the number of aircraft, their times of arrival are
independent and uniform. Aircraft that are there at the start have come before it. Each aircraft is drawn by its number
alone: a sky of one more has all others as they were.
"""

from math import ceil, cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.skies.files import Target
from cogradar.shared.numerics.constants import G_KM_S2
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.world_config import TargetSection
from cogradar.shared.world.targets import undisturbed_path

LONGEST_S_KM = 15  # that an aircraft may stay, per km to the edge
SHORTEST_S = 60
PER_AIRWAY = 3  # aircraft
FIRST = 5  # airways of the first aircraft; of so many aircraft one is there at the start
END = 0.42 * pi  # of an airway, at most so far from boresight, rad
SPREAD_KM = 2.0  # about an airway, standard deviation
SPEEDS_KM_S = (0.18, 0.26)
TURNS_G = (0.15, 0.5)
TURNS_RAD = (0.35, 1.6)
MOST_TURNS = 2


class Airway(NamedTuple):
    """A straight line across the field of view, from one end to the other, km."""

    begin: tuple[float, float]
    end: tuple[float, float]


def traffic(n: int, seconds: int, range_km: float, seed: int) -> list[Target]:
    """n aircraft within a range that are there at some time of these seconds, at least one of them at the start.

    Their times are whole seconds. If none of the first five is there, the first of them to come begins at the start.
    """
    n_airway = [max(i // PER_AIRWAY + 2, FIRST) for i in range(n)]  # of which each aircraft follows one
    airways = [_airway(range_km, seed, i) for i in range(n_airway[-1])]
    flown = [_seen(airways[: n_airway[i]], range_km, seconds, generator(seed, Purpose.SKY, i, 0)) for i in range(n)]
    if all(arrival > 0 for arrival, _, _ in flown[:FIRST]):
        first = min(range(min(n, FIRST)), key=lambda i: flown[i][0])
        flown[first] = (0, *flown[first][1:])
    return [_target(arrival, target, states, range_km) for arrival, target, states in flown]


def _airway(range_km: float, seed: int, i: int) -> Airway:
    """From the edge to the edge, or every other time to the array's line, behind which the radar sees nothing."""
    rng = generator(seed, Purpose.SKY, -1, i)
    here = rng.uniform(-END, END)
    there = (here + END + rng.uniform(0.5, 1.0) * END) % (2.0 * END) - END
    begin = range_km * cos(here), range_km * sin(here)
    if i % 2:
        return Airway(begin, (-0.1, rng.uniform(-0.7, 0.7) * range_km))
    return Airway(begin, (range_km * cos(there), range_km * sin(there)))


def _seen(
    airways: list[Airway], range_km: float, seconds: int, rng: np.random.Generator
) -> tuple[int, Target, NDArray[np.float64]]:
    """When an aircraft that is seen arrives, what it is then, and its states second by second, (n, 4)."""
    while True:
        arrival = int(rng.integers(-int(LONGEST_S_KM * range_km), seconds))
        target = _aircraft(airways[rng.integers(len(airways))], range_km, rng)
        if target["state"][0] < 0.0:
            continue
        states = _path(TargetSection.model_validate(target), range_km)
        if len(states) >= SHORTEST_S and arrival + len(states) > SHORTEST_S:
            return arrival, target, states


def _aircraft(airway: Airway, range_km: float, rng: np.random.Generator) -> Target:
    """An aircraft as it arrives: state, and turns from then on."""
    ends = np.array(airway)[:: rng.choice((-1, 1))]
    course = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    begin = ends[0] + SPREAD_KM * rng.standard_normal() * np.array([-course[1], course[0]])
    begin *= min(1.0, 0.999 * range_km / np.hypot(*begin))
    begin[0] = 0.0 if -1.0 < begin[0] < 0.0 else begin[0]
    speed = rng.uniform(*SPEEDS_KM_S)
    velocity = speed * course
    turns, free_s = [], 60.0
    for _ in range(rng.integers(MOST_TURNS + 1)):
        g, angle = rng.uniform(*TURNS_G), rng.uniform(*TURNS_RAD)
        from_s = round(free_s + rng.uniform(0.0, 240.0))
        to_s = from_s + max(1, round(angle * speed / (g * G_KM_S2)))
        turns.append({"from_s": from_s, "to_s": to_s, "g": round(float(g * rng.choice((-1, 1))), 3)})
        free_s = to_s + 30.0
    state = [begin[0], velocity[0], begin[1], velocity[1]]
    return {"state": [round(float(value), 4) for value in state], "turns": turns}


def _path(target: TargetSection, range_km: float) -> NDArray[np.float64]:
    """States of a target second by second, without noise, for as long as it is in view, (n, 4)."""
    states = undisturbed_path(target, 1.0, ceil(LONGEST_S_KM * range_km))
    is_gone = (states[:, 0] < 0.0) | (np.hypot(states[:, 0], states[:, 2]) > range_km)
    return states[: np.argmax(is_gone)] if is_gone.any() else states


def _target(arrival: int, target: Target, states: NDArray[np.float64], range_km: float) -> Target:
    """The aircraft in the time of the scenario, which begins with clock 0; it dies where it leaves the edge."""
    found: Target = {"state": target["state"]}
    if arrival > 0:
        found["born_s"] = float(arrival)
    else:
        found["state"] = [round(float(value), 4) for value in states[-arrival]]
    end = states[-1] + [states[-1, 1], 0.0, states[-1, 3], 0.0]
    if np.hypot(end[0], end[2]) > 0.999 * range_km or len(states) >= LONGEST_S_KM * range_km:
        found["gone_s"] = float(arrival + len(states) - 1)
    shifted = [
        {"from_s": float(max(turn["from_s"] + arrival, 0)), "to_s": float(turn["to_s"] + arrival), "g": turn["g"]}
        for turn in target["turns"]
        if turn["to_s"] + arrival > 0 and turn["from_s"] < len(states)
    ]
    return found | ({"turns": shifted} if shifted else {})
