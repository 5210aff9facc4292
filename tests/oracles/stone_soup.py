"""The metrics of Stone Soup, foreign code for the same definitions, of tracks and truths by id and dwell."""

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from stonesoup.dataassociator.tracktotrack import TrackToTruth
from stonesoup.measures import Euclidean
from stonesoup.metricgenerator.manager import MultiManager
from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
from stonesoup.metricgenerator.tracktotruthmetrics import SIAPMetrics
from stonesoup.types.groundtruth import GroundTruthPath
from stonesoup.types.state import State
from stonesoup.types.track import Track

CUT_OFF_KM = 5.0
BEGAN = datetime(2000, 1, 1)
States = Mapping[int, Mapping[int, NDArray[np.float64]]]  # by id and dwell, (4,) [x, vx, y, vy]


class Metrics(NamedTuple):
    """GOSPA's parts and OSPA squared of each dwell, (T,), km^2; SIAP of all dwells."""

    localisation: list[float]
    missed: list[float]
    false: list[float]
    ospa: list[float]
    completeness: float
    ambiguity: float
    spuriousness: float


def metrics(tracks: States, truths: States) -> Metrics:
    """Of tracks and truths; in each dwell there is one of them at least."""
    paths = {GroundTruthPath(_states(states)) for states in truths.values()}
    return metrics_of({Track(_states(states)) for states in tracks.values()}, paths)


def metrics_of(tracks: set[Track], paths: set[GroundTruthPath]) -> Metrics:
    """Of Stone Soup's own tracks and paths."""
    position, velocity = Euclidean(mapping=[0, 2]), Euclidean(mapping=[1, 3])
    manager = MultiManager(
        [
            GOSPAMetric(p=2, c=CUT_OFF_KM, measure=position, generator_name="gospa"),
            OSPAMetric(p=2, c=CUT_OFF_KM, measure=position, generator_name="ospa"),
            SIAPMetrics(position_measure=position, velocity_measure=velocity, generator_name="siap"),
        ],
        TrackToTruth(association_threshold=CUT_OFF_KM, measure=position, consec_pairs_confirm=1, consec_misses_end=1),
    )
    manager.add_data({"tracks": tracks, "groundtruth_paths": paths})
    found = manager.generate_metrics()
    gospa = [one.value for one in found["gospa"]["GOSPA Metrics"].value]
    siap = found["siap"]
    return Metrics(
        [dwell["localisation"] for dwell in gospa],
        [dwell["missed"] for dwell in gospa],
        [dwell["false"] for dwell in gospa],
        [one.value**2 for one in found["ospa"]["OSPA distances"].value],
        siap["SIAP Completeness"].value,
        siap["SIAP Ambiguity"].value,
        siap["SIAP Spuriousness"].value,
    )


def _states(states: Mapping[int, NDArray[np.float64]]) -> list[State]:
    return [State(state, timestamp=BEGAN + timedelta(seconds=t)) for t, state in sorted(states.items())]


def state(numbers: NDArray[np.float64]) -> State:
    """A state of theirs, (4,)."""
    return State(numbers)
