"""A tracker of Stone Soup on the detections of runs: GOSPA of both trackers beside each other.

    python -m studies.stone_soup SCENARIO... [--seed N] [--dwells N]

Each scenario has `radar.tracks = "unknown"`, monopulse and range cells. It is played in this process. The detections
are those of `cogradar export --what detections`: they were made where this radar's tracker looked. The other tracker is
an unscented Kalman filter with global nearest neighbours, three detections to confirm a track, and the motion
constant of the radar.
"""

import argparse
from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cogradar
from cogradar.shared.scoring.figures import Figures, Totals
from cogradar.shared.scoring.picture import AirPicture, Objects

BEGAN = datetime(2000, 1, 1)
CONFIRMED_AFTER, ENDED_AFTER = 3, 5  # detections, dwells without one
GATE = 4.0  # Mahalanobis distance
V_SIGMA_KM_S = 0.3  # of a new track
Floats = NDArray[np.float64]
Tracks = dict[int, tuple[list[int], Floats]]  # by dwell t: ids, and states (n, 4)


class Compared(NamedTuple):
    """GOSPA (p 2, c 5 km) and its parts for a run, km."""

    scenario: str
    tracker: str
    gospa_km: float
    localisation_km: float
    missed_km: float
    false_km: float


def compare(scenario: str, seed: int, dwells: int | None) -> list[Compared]:
    """Both trackers on one run."""
    result = cogradar.run(scenario, seed=seed, dwells=dwells)
    own: Tracks = {}
    for i, t in enumerate(result.t.tolist()):
        shown = np.flatnonzero(result.tracks.alive[i] & result.tracks.confirmed[i])
        own[t] = result.tracks.numbers[shown].tolist(), result.tracks.estimates[i, shown]
    found = {"cogradar": own, "Stone Soup UKF": _followed(result)}
    rows = []
    for name, tracks in found.items():
        figures = _figures(result, tracks)
        parts = figures.gospa_localisation_km, figures.gospa_missed_km, figures.gospa_false_km
        rows.append(Compared(result.scenario.name, name, figures.gospa_km, *parts))
    return rows


def _figures(result: cogradar.Result, tracks: Tracks) -> Figures:
    """The figures of tracks, by the rule of this program: of targets that were visible by then."""
    picture, total = AirPicture(), [0.0] * len(Totals._fields)
    visible, truth = result.column("visible"), result.truth
    counting = np.maximum.accumulate(visible, axis=0)
    for i, t in enumerate(result.t.tolist()):
        there = np.flatnonzero(result.present[i])
        targets = Objects((there + 1).tolist(), truth[i, there])
        dwell, _ = picture.advance(t, Objects(*tracks[t]), targets, counting[i, there].tolist())
        total = [a + b for a, b in zip(total, dwell, strict=True)]
    return Figures.of(Totals._make(total), result.scenario.radar.motion.dt_s)


def _followed(result: cogradar.Result) -> Tracks:
    """Tracks of Stone Soup in each dwell."""
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.deleter.time import UpdateTimeStepsDeleter
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.initiator.simple import MultiMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.tracker.simple import MultiTargetTracker
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    motion = result.scenario.radar.motion
    along = ConstantVelocity(motion.sigma_s_km_s2**2 * motion.dt_s)
    updater = UnscentedKalmanUpdater(None)
    predictor = UnscentedKalmanPredictor(CombinedLinearGaussianTransitionModel([along, along]))
    associator = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=GATE))
    deleter = UpdateTimeStepsDeleter(ENDED_AFTER)
    prior = GaussianState([[0.0], [0.0], [0.0], [0.0]], np.diag([1.0, V_SIGMA_KM_S**2, 1.0, V_SIGMA_KM_S**2]))
    initiator = MultiMeasurementInitiator(prior, deleter, associator, updater, min_points=CONFIRMED_AFTER)
    tracker = MultiTargetTracker(initiator, deleter, list(_scans(result)), associator, updater)
    found, numbers = Tracks(), dict[str, int]()
    for t, (_, tracks) in zip(result.t.tolist(), tracker, strict=True):
        ids = [numbers.setdefault(track.id, len(numbers) + 1) for track in tracks]
        found[t] = ids, np.array([track.state_vector for track in tracks], dtype=np.float64).reshape(-1, 4)
    return found


def _scans(result: cogradar.Result) -> Iterator[tuple[datetime, set[Any]]]:
    """Time and detections of each dwell: of those of one range cell and direction the strongest."""
    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.types.detection import Detection

    cells, radar = result.detected_cells, result.scenario.radar
    if np.isnan(cells.nu_measured).any() or np.isnan(cells.range_km).any():
        raise cogradar.BadInput("a detection has no measured direction, or no range: use fidelity best-range")
    lobe = 1.0 / radar.array.n_rx
    for t in result.t.tolist():
        time, kept = BEGAN + timedelta(seconds=t * radar.motion.dt_s), list[int]()
        at = np.flatnonzero(cells.t == t)
        for i in at[np.argsort(-cells.statistic[at], kind="stable")].tolist():
            near = np.abs(cells.nu_measured[kept] - cells.nu_measured[i]) < lobe
            if not (near & (cells.range_km[kept] == cells.range_km[i])).any():
                kept.append(i)
        found = set()
        for i in kept:
            sine = float(np.clip(2.0 * cells.nu_measured[i], -0.999, 0.999))
            sigma = 2.0 * cells.nu_measured_sigma[i] / np.sqrt(1.0 - sine**2)
            noise = np.diag([sigma**2, radar.receiver.range_cell_km**2 / 12.0])
            model = CartesianToBearingRange(ndim_state=4, mapping=(0, 2), noise_covar=noise)
            place = np.array([[np.arcsin(sine)], [cells.range_km[i]]])
            found.add(Detection(place, timestamp=time, measurement_model=model))
        yield time, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="+", help="names, or files")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dwells", type=int, default=None)
    given = parser.parse_args()
    print(f"{'scenario':20} {'tracker':16} {'GOSPA km':>9} {'errors':>7} {'missed':>7} {'false':>7}")
    for scenario in given.scenarios:
        for name, tracker, *numbers in compare(scenario, given.seed, given.dwells):
            print(f"{name:20} {tracker:16} {numbers[0]:9.3f} {numbers[1]:7.3f} {numbers[2]:7.3f} {numbers[3]:7.3f}")


if __name__ == "__main__":
    main()
