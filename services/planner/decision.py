"""Which bin a track asks for next: belief and search composed."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.numerics.seeds import Purpose, generator
from shared.planning.radar_pomdp import RadarPomdp, problem_of
from shared.planning.rules import Choice, chosen_bin, most_probable_bin
from shared.scenario.radar_config import PlannerSection
from shared.tracking import track
from shared.tracking.association import expected_sigma
from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import covariance_of_state, mean_state, predicted_mean


@dataclass(frozen=True)
class Decision:
    """What a track asks for after a dwell."""

    bin: int  # angle bin to illuminate next
    range_km: float  # expected range at the next dwell
    estimate: NDArray[np.float64]  # (4,) belief mean now
    covariance: NDArray[np.float64]  # (4, 4) of the belief now
    n_sim: int  # simulations behind the choice


def decide(
    planner: PlannerSection, model: TrackerModel, state: TrackState, has_time: Callable[[], bool] | None = None
) -> Decision:
    """Choose the bin to look at next: by the planner's rule, or the most probable one if every cell is tested anyway.

    has_time : false as soon as the search must end (real time); without it, it makes all its simulations
    """
    estimate = mean_state(state.particles)
    predicted = predicted_mean(estimate, model.motion.dt)
    if model.tests_every_cell:
        choice = Choice(most_probable_bin(state.particles, model.sensor.n_bin, model.motion.dt), 0)
    else:
        rng = generator(model.seed, Purpose.SEARCH, state.target, state.k)
        choice = chosen_bin(problem_after(model, state), planner, rng, has_time)
    return Decision(
        bin=choice.bin,
        range_km=float(np.hypot(predicted[0], predicted[2])),
        estimate=estimate,
        covariance=covariance_of_state(state.particles, estimate),
        n_sim=choice.n_sim,
    )


def problem_after(model: TrackerModel, state: TrackState) -> RadarPomdp:
    """What a track has to decide after a dwell."""
    sigma_hat = float(expected_sigma(model, state, state.power))
    return problem_of(state.particles, sigma_hat, model.sensor, model.motion)


def warm_up(planner: PlannerSection, model: TrackerModel) -> None:
    """Load every kernel that a run may need: track nothing, and search for it without time."""
    decide(planner, model, track.warm_up(model), lambda: False)
