"""What each tracker comes to on one run, by the rules of this program."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

import cogradar
from cogradar.shared.scoring.errors import FLIGHTS, nees, position_error, velocity_error
from cogradar.shared.scoring.figures import Figures, Totals
from cogradar.shared.scoring.picture import AirPicture, Objects
from studies.trackers import imm_ekf, ukf
from studies.trackers.scans import Floats, Followed, scans

OWN, IMM, UKF = TRACKERS = ("cogradar", "IMM-EKF", "Stone Soup UKF")
TURNS = FLIGHTS[1:]  # all dwells are not asked for


class Score(NamedTuple):
    """One tracker on one run; NaN: of nothing."""

    gospa_km: float  # p 2, c 5 km
    localisation_km: float
    missed_km: float
    false_km: float
    missed: float  # share of target-dwells, in percent
    false: float  # share of track-dwells
    swaps: float
    rmse_m: float
    velocity_m_s: float  # root mean square error
    nees: tuple[float, ...]  # means, by TURNS


def compare(scenario: cogradar.Scenario, seed: int, dwells: int | None = None) -> dict[str, Score]:
    """All trackers on one run; scores by name. Raises BadInput without directions or ranges."""
    result = cogradar.run(scenario, seed=seed, dwells=dwells)
    motion = result.scenario.radar.motion
    found = list(scans(result.detections().columns(), result.t.tolist(), 1.0 / result.scenario.radar.array.n_rx))
    return {
        OWN: score(result, _own(result)),
        IMM: score(result, imm_ekf.followed(found, motion.dt_s, motion.sigma_straight_km_s2)),
        UKF: score(result, ukf.followed(found, motion.dt_s, motion.sigma_s_km_s2)),
    }


def _own(result: cogradar.Result) -> Iterable[Followed]:
    tracks = result.by_track
    for i in range(result.t.size):
        at = np.flatnonzero(tracks.alive[i] & tracks.confirmed[i])
        yield Followed(tracks.numbers[at].tolist(), tracks.estimates[i, at], tracks.covariance[i, at])


def score(result: cogradar.Result, followed: Iterable[Followed]) -> Score:
    """Score of the tracks of each dwell, of targets that were visible by then."""
    picture, total = AirPicture(), [0.0] * len(Totals._fields)
    truth, accelerations = result.true_states, result.column("acceleration_g")
    counting = np.maximum.accumulate(result.column("visible"), axis=0)
    errors = list[tuple[float, float, float, float]]()  # km, km/s, NEES, g
    for i, (t, tracks) in enumerate(zip(result.t.tolist(), followed, strict=True)):
        there = np.flatnonzero(result.present[i])
        targets = Objects((there + 1).tolist(), truth[i, there])
        dwell, followers = picture.advance(t, Objects(tracks.ids, tracks.states), targets, counting[i, there].tolist())
        total = [a + b for a, b in zip(total, dwell, strict=True)]
        for target, track in followers.items():
            n = tracks.ids.index(track)
            pair = tracks.states[n], truth[i, target - 1]
            value = nees(pair[0] - pair[1], tracks.covariances[n])
            far, fast = float(position_error(*pair)), float(velocity_error(*pair))
            errors.append((far, fast, np.nan if value is None else value, float(accelerations[i, target - 1])))
    figures = Figures.of(Totals._make(total), result.scenario.radar.motion.dt_s)
    km, km_s, values, gs = np.array(errors, dtype=np.float64).reshape(-1, 4).T
    return Score(
        figures.gospa_km,
        figures.gospa_localisation_km,
        figures.gospa_missed_km,
        figures.gospa_false_km,
        100.0 * (1.0 - figures.completeness) if figures.completeness is not None else np.nan,
        100.0 * figures.spuriousness if figures.spuriousness is not None else np.nan,
        figures.swaps,
        1e3 * _root(km),
        1e3 * _root(km_s),
        tuple(_mean(values[(flight.low_g <= gs) & (gs < flight.high_g)]) for flight in TURNS),
    )


def _root(errors: Floats) -> float:
    return float(np.sqrt(np.mean(errors**2))) if errors.size else np.nan


def _mean(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else np.nan
