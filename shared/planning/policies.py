"""Which bin a track asks for next: the one that the search finds, or the most probable one."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.planning.pomcp import SearchSettings, search, search_while
from shared.planning.radar_pomdp import RadarPomdp, legal_actions
from shared.scenario.radar_config import PlannerSection
from shared.tracking.motion import predicted_bins

# Visits per legal action, on average. With fewer the largest of many noisy means is an arbitrary one: of a belief over
# three bins, 2.5 visits chose a bin less probable than the best by 0.13 on average, 10 visits by 0.01.
MIN_VISITS = 10


class Choice(NamedTuple):
    """A bin, and the simulations that were made to find it."""

    bin: int
    n_sim: int


def most_probable_bin(particles: NDArray[np.float64], n_bin: int, dt: float) -> int:
    """Bin into which most particles, (n, 4), are expected to move in dt seconds; the first among equals."""
    return int(np.argmax(predicted_bins(particles, n_bin, dt)))


def searched_bin(
    problem: RadarPomdp,
    planner: PlannerSection,
    rng: np.random.Generator,
    has_time: Callable[[], bool] | None = None,
) -> Choice:
    """Bin that POMCP chooses for a target.

    has_time : false as soon as the search must end; without it, all simulations of the planner are made. A search that
               was cut short below MIN_VISITS visits per legal action falls back to `most_probable_bin`.
    """
    settings = SearchSettings(
        planner.n_sim,
        planner.depth,
        planner.rollout_depth,
        planner.rollout == "mean",
        planner.gamma,
        planner.ucb_c,
    )
    if planner.actions == "belief":
        actions = legal_actions(problem.particles, problem.n_bin, problem.motion.dt, planner.widen_bins)
    else:
        actions = np.arange(problem.n_bin)
    if has_time is None:
        return Choice(int(search(problem, actions, settings, rng).action), settings.n_sim)
    found = search_while(problem, actions, settings, rng, has_time)
    n_sim = int(found.visits.sum())
    if n_sim < min(settings.n_sim, MIN_VISITS * actions.size):
        return Choice(most_probable_bin(problem.particles, problem.n_bin, problem.motion.dt), n_sim)
    return Choice(int(found.action), n_sim)
