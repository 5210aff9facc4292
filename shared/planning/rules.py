"""The rules by which a track chooses the angle bin that it asks for next.

A rule is a function (problem, radar, rng, has_time) -> Choice; `cogradar.shared.scenario.tables.BIN_RULES` has the
built-in ones.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.planning.exact import values_of
from cogradar.shared.planning.pomcp import SearchSettings, search, search_while
from cogradar.shared.planning.radar_pomdp import RadarPomdp, legal_actions
from cogradar.shared.scenario.plugins.kinds import RULE
from cogradar.shared.scenario.plugins.names import PluginRefused
from cogradar.shared.scenario.plugins.resolver import Caller, resolve
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.angle import bin_of
from cogradar.shared.tracking.motion import mean_state, predicted_bins, predicted_mean

# Visits per legal action, on average. With fewer the largest of many noisy means is an arbitrary one. Of a belief over
# three bins, 2.5 visits chose a bin less probable than the best by 0.13 on average, 10 visits by 0.01.
MIN_VISITS = 10
MAX_SIMULATIONS = 2**31 - 1  # that a choice can say


class Choice(NamedTuple):
    """A bin, and the simulations that were made to find it."""

    bin: int
    n_sim: int


class BinRule(Protocol):
    """An action-selection policy. `has_time` is false once the answer is due; without it there is all the time."""

    def __call__(
        self,
        problem: RadarPomdp,
        radar: RadarConfig,
        rng: np.random.Generator,
        has_time: Callable[[], bool] | None = None,
    ) -> Choice:
        """Bin for a target."""


def chosen_bin(
    problem: RadarPomdp,
    radar: RadarConfig,
    rng: np.random.Generator,
    has_time: Callable[[], bool] | None = None,
) -> Choice:
    """Bin that the radar's rule chooses for a target."""
    rule: BinRule = resolve(RULE, radar.planner.rule)
    return rule(problem, radar, rng, has_time)


def guarded(rule: Any, call: Caller) -> BinRule:
    """A user's own rule, whose bins are on the grid. Raises PluginRefused if it cannot be called."""
    if not callable(rule):
        raise PluginRefused(f"{call.short}: must be a function (problem, radar, rng, has_time) -> Choice")

    def asked(
        problem: RadarPomdp,
        radar: RadarConfig,
        rng: np.random.Generator,
        has_time: Callable[[], bool] | None = None,
    ) -> Choice:
        # A rule may write into its argument. The particles are the belief itself, and kernels crash on NaN in it.
        own = problem._replace(particles=problem.particles.copy())
        answer = call(rule, own, radar, rng, has_time)
        if not (isinstance(answer, tuple) and len(answer) == len(Choice._fields)):
            raise call.failed(f"returned {answer!r}: must be a Choice of a bin and a number of simulations")
        bin_, n_sim = answer
        if not (_is_whole(bin_) and 0 <= bin_ < problem.n_bin):
            raise call.failed(f"returned bin {bin_!r}: must be a whole number from 0 to {problem.n_bin - 1}")
        if not (_is_whole(n_sim) and 0 <= n_sim <= MAX_SIMULATIONS):
            raise call.failed(f"returned n_sim {n_sim!r}: must be a whole number from 0 to {MAX_SIMULATIONS}")
        return Choice(int(bin_), int(n_sim))

    return asked


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def most_probable_bin(particles: NDArray[np.float64], n_bin: int, dt: float) -> int:
    """Bin into which most particles, (n, 4), are expected to move in dt seconds; the first among equals."""
    return int(np.argmax(predicted_bins(particles, n_bin, dt)))


def pomcp(
    problem: RadarPomdp,
    radar: RadarConfig,
    rng: np.random.Generator,
    has_time: Callable[[], bool] | None = None,
) -> Choice:
    """Bin that POMCP chooses for a target.

    has_time : false as soon as the search must end; without it, all simulations are made. A search that was cut short
               below MIN_VISITS visits per legal action falls back to `most_probable_bin`.
    """
    planner, is_published = radar.planner, radar.belief.filter == "published"
    settings = SearchSettings(
        planner.n_sim, planner.depth, planner.rollout_depth, not is_published, planner.gamma, planner.ucb_c
    )
    widen = problem.n_bin if is_published else planner.widen_bins  # by all bins: every bin is legal
    actions = legal_actions(problem.particles, problem.n_bin, problem.motion.dt, widen)
    if has_time is None:
        return Choice(int(search(problem, actions, settings, rng).action), settings.n_sim)
    found = search_while(problem, actions, settings, rng, has_time)
    n_sim = int(found.visits.sum())
    if n_sim < min(settings.n_sim, MIN_VISITS * actions.size):
        return Choice(most_probable_bin(problem.particles, problem.n_bin, problem.motion.dt), n_sim)
    return Choice(int(found.action), n_sim)


def exact(
    problem: RadarPomdp,
    radar: RadarConfig,
    _rng: np.random.Generator | None = None,
    has_time: Callable[[], bool] | None = None,
) -> Choice:
    """The bin of the largest depth-2 value, worked out over all particles and levels; the first among equals.

    Nothing can stop it, so that an answer that is due already is `most_probable_bin`.
    """
    if has_time is not None and not has_time():
        return mode(problem)
    values = values_of(problem, radar.planner.gamma)
    return Choice(values.first_bin + int(np.argmax(values.q)), 0)


def mode(problem: RadarPomdp, *_: object) -> Choice:
    """The most probable bin; no search."""
    return Choice(most_probable_bin(problem.particles, problem.n_bin, problem.motion.dt), 0)


def mean(problem: RadarPomdp, *_: object) -> Choice:
    """The bin of the belief's predicted mean; no search. After a miss it may lie between the bins that are left."""
    x, _vx, y, _vy = predicted_mean(mean_state(problem.particles), problem.motion.dt).tolist()
    return Choice(int(bin_of(x, y, problem.n_bin)), 0)
