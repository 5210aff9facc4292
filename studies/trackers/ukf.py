"""Stone Soup's unscented Kalman filter with its global nearest neighbours and the motion constant of the radar."""

from collections.abc import Iterable, Iterator
from datetime import datetime, timedelta
from math import hypot
from typing import Any

import numpy as np

from studies.trackers.imm_ekf import CONFIRMED_AFTER, ENDED_AFTER, GATE, V_SIGMA_KM_S
from studies.trackers.scans import Followed, Scan

BEGAN = datetime(2000, 1, 1)
BESIDE, BESIDE_KM = 2.0 * GATE, 2.0  # more standard deviations, or km, from the prediction: not in the gate


def followed(scans: Iterable[Scan], dt: float, sigma_s: float) -> Iterator[Followed]:
    """Confirmed tracks after each scan."""
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

    along = ConstantVelocity(sigma_s**2 * dt)
    updater = UnscentedKalmanUpdater(None)
    predictor = UnscentedKalmanPredictor(CombinedLinearGaussianTransitionModel([along, along]))

    class Near(DistanceHypothesiser):  # type: ignore[misc] # Stone Soup has no types
        """Of detections that cannot be in a track's gate no measurement is predicted: it is what takes the time."""

        def hypothesise(self, track: Any, detections: set[Any], timestamp: datetime, **how: Any) -> Any:
            predicted = predictor.predict(track, timestamp=timestamp)
            x, y = (float(predicted.state_vector[i, 0]) for i in (0, 2))
            sigma = float(np.sqrt(predicted.covar[0, 0] + predicted.covar[2, 2]))
            near = {
                one
                for one in detections
                if hypot(one.metadata["x"] - x, one.metadata["y"] - y) < BESIDE * sigma + BESIDE_KM
            }
            return super().hypothesise(track, near, timestamp, **how)

    associator = GNNWith2DAssignment(Near(predictor, updater, Mahalanobis(), missed_distance=GATE))
    deleter = UpdateTimeStepsDeleter(ENDED_AFTER)
    prior = GaussianState([[0.0], [0.0], [0.0], [0.0]], np.diag([1.0, V_SIGMA_KM_S**2, 1.0, V_SIGMA_KM_S**2]))
    initiator = MultiMeasurementInitiator(prior, deleter, associator, updater, min_points=CONFIRMED_AFTER)
    detected = ((BEGAN + timedelta(seconds=scan.t * dt), _detections(scan, dt)) for scan in scans)
    numbers = dict[str, int]()
    for _, tracks in MultiTargetTracker(initiator, deleter, detected, associator, updater):
        found = list(tracks)
        ids = [numbers.setdefault(track.id, len(numbers) + 1) for track in found]
        states = np.array([track.state_vector for track in found], dtype=np.float64).reshape(-1, 4)
        yield Followed(ids, states, np.array([track.covar for track in found], dtype=np.float64).reshape(-1, 4, 4))


def _detections(scan: Scan, dt: float) -> set[Any]:
    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.types.detection import Detection

    found = set()
    for nu, nu_sigma, range_km in zip(*map(np.ndarray.tolist, scan[1:4]), strict=True):
        sine = float(np.clip(2.0 * nu, -0.999, 0.999))
        sigma = 2.0 * nu_sigma / np.sqrt(1.0 - sine**2)
        noise = np.diag([sigma**2, scan.range_sigma_km**2])
        model = CartesianToBearingRange(ndim_state=4, mapping=(0, 2), noise_covar=noise)
        time = BEGAN + timedelta(seconds=scan.t * dt)
        place = {"x": range_km * np.sqrt(1.0 - sine**2), "y": range_km * sine}
        state = np.array([[np.arcsin(sine)], [range_km]])
        found.add(Detection(state, timestamp=time, measurement_model=model, metadata=place))
    return found
