"""Which bin a track asks for next: belief and search composed."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.numerics.seeds import Purpose, generator
from shared.planning.radar_pomdp import plan
from shared.scenario.radar_config import RadarConfig
from shared.tracking import track
from shared.tracking.association import expected_sigma
from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import mean_state, predict_mean, predicted_bins


@dataclass(frozen=True)
class Decision:
    """What a track asks for after a dwell."""

    bin: int  # angle bin to illuminate next
    range_km: float  # expected range at the next dwell
    estimate: NDArray[np.float64]  # (4,) belief mean now
    n_sim: int  # simulations behind the choice


def decide(
    radar: RadarConfig, model: TrackerModel, state: TrackState, has_time: Callable[[], bool] | None = None
) -> Decision:
    """Choose the bin to look at next: POMCP, or where the belief is densest when every cell is tested anyway.

    has_time : false as soon as the search must end (real time); without it, it makes all its simulations
    """
    estimate = mean_state(state.particles)
    predicted = predict_mean(estimate[np.newaxis], model.motion.dt)
    if model.tests_every_cell:
        bin_, n_sim = int(np.argmax(predicted_bins(state.particles, model.sensor.n_bin, model.motion.dt))), 0
    else:
        rng = generator(model.seed, Purpose.SEARCH, state.target, state.k)
        found = plan(state.particles, float(expected_sigma(model, state, state.power)), radar, rng, has_time)
        bin_, n_sim = int(found.action), int(found.visits.sum())
    return Decision(bin_, float(np.hypot(predicted[0], predicted[2])), estimate, n_sim)


def warm_up(radar: RadarConfig, model: TrackerModel) -> None:
    """Load every kernel that a run may need: track nothing, and search for it without time."""
    decide(radar, model, track.warm_up(model), lambda: False)
