"""An action-selection policy: which angle bin a track asks for. `cogradar run paper --rule FILE.py:ahead` uses it."""

from collections.abc import Callable

import numpy as np

from cogradar.plugins import Choice, RadarConfig, RadarPomdp, most_probable_bin


def ahead(
    problem: RadarPomdp, radar: RadarConfig, rng: np.random.Generator, has_time: Callable[[], bool] | None = None
) -> Choice:
    """The most probable bin after two dwells.

    problem  : particles (n, 4) of [x, vx, y, vy] in km and km/s, with motion, sensor and number of bins
    radar    : the table [radar]
    rng      : the only source of random numbers that keeps equal runs equal
    has_time : in real time false as soon as the answer is due; None: there is all the time
    returns  : a bin from 0, and how many simulations are behind it
    """
    return Choice(most_probable_bin(problem.particles, problem.n_bin, 2.0 * problem.motion.dt), 0)
