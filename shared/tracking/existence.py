"""Whether there is a target: how a track of an unknown number begins, is confirmed, and ends.

A track begins with a detection that no other track claims, and lives by r, the probability that there is a target
(Bernoulli filter; Ristic, Vo, Vo and Farina 2013). From dwell to dwell a target survives with probability p_S. Each
look of the track multiplies the odds:

    r / (1 - r)  ->  r / (1 - r) (1 - P_D)     a miss, in looks that find the target with probability P_D
    r / (1 - r)  ->  r / (1 - r) L(u)          a detection

u is the probability that the largest statistic of the same cells exceeds the detection's without a target: even
in 0 .. P_FA under noise. Of a target of unknown strength small values are common. Its density falls as a power of u, so
that

    L(u) = P_D kappa / P_FA (u / P_FA)^(kappa - 1),    0 < u <= P_FA

is a likelihood ratio whatever the limit was. (With 32 x 32 channels and less noise has more large statistics than u
says, as sigma_hat is estimated. Strong detections are believed too much there.) A tentative track is confirmed when r
exceeds a bound, and ends when r falls below another. Under noise the odds are a random walk of independent steps: the
bound of confirmation is where that walk confirms as many false tracks per hour as `radar.initiation` asks for.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import exp, expm1, log, log1p
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics import elementwise
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import inner, solve
from cogradar.shared.scenario.limits import ALERTS, SECONDS_PER_HOUR
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.tracking.belief.interface import Belief

if TYPE_CHECKING:
    from cogradar.shared.tracking.model import TrackState

UNDETECTED_PER_S = 0.02  # targets without a track that the looks of the search meet
KAPPA = 0.2  # exponent of the density of u for a target: the median of u is P_FA / 32
MOST_P_FA = 0.1  # of a look
UNSEEN = 0.8  # of the odds is left after a dwell whose looks all went elsewhere: a track not worth any is forgotten
SURVIVES_S = 600.0  # mean time for which a target stays
DOUBTED_BELOW = 0.5  # of r: a confirmed track is tentative again
ENDED_BELOW = 0.005  # of the probability that there is a target and that it is in its most probable cell
# Of r: a target that leaves is given up after some five misses where it would be found with 0.9. Ten times the odds
# that confirm it, if these are more.
MOST_ODDS = 1e3
# P_D by which a miss is judged, whatever the belief says. A target that has turned is missed although it is strong.
# With an unknown RCS a target that has left would seem weaker with each miss, and would never be given up.
LEAST_P_D, MOST_P_D = 0.3, 0.9
_HIGHEST = 1e9  # bound of confirmation, odds
_STEP = 0.05  # of log odds, in the random walk of a false track
_LOOKS, _P_D = 25, 0.6  # of the search and of a look, for which the bound of confirmation is exact
_TINY = 1e-300


class TrackLooks(NamedTuple):
    """The looks that were made for a track of an unknown number: what says whether there is a target at all."""

    is_looked: bool = False  # there was one
    is_hit: bool = False  # ... with the track's detection
    p_fa: float = 1.0  # probability of a false detection in them, by the limit of the track's detection; 1 without one
    u: float = 1.0  # ... by the statistic of that detection
    unresolved: float = 0.0  # without one: probability that the target's echo is in the cell of another's
    is_unmeasured: bool = False  # one that was asked for was not measured
    is_stale: bool = False  # they were asked for before the target flew elsewhere, as its belief says


class Judged(TypedDict):
    """Fields of a track's state."""

    existence: float  # probability that there is a target
    confirmed: bool


class Existence(Protocol):
    """How the tracks of a run know whether there is a target."""

    def at_birth(self, limit: float, r: float, n_cell: int) -> float:
        """Probability that a detection of the search is a target's.

        limit  : what its statistic was compared with
        r      : |alpha_hat| / sigma_hat
        n_cell : number of range cells of its look
        """

    def is_confirmed(self, existence: float) -> bool:
        """Whether a tentative track with this probability of existence is one no longer."""

    def survival(self, before: Belief, after: Belief) -> float:
        """Probability that a target has not left in a dwell, of its belief before it and after."""

    def after(self, existence: float, confirmed: bool, own: TrackLooks, evidence: float) -> "Judged":
        """What a dwell leaves of the probability of existence, and of being confirmed.

        existence : before the looks of the dwell
        evidence  : probability that the belief gives to a miss; without a belief of it 1 - MOST_P_D
        """

    def is_over(self, state: "TrackState", chance: float) -> bool:
        """Whether a track is to be given up.

        chance : probability that the target, if there is one, is in the cell where it is most probable
        """


class CertainExistence:
    """Announced targets: there is one of each track, whatever is missed."""

    def at_birth(self, _limit: float, _r: float, _n_cell: int) -> float:
        return 1.0

    def is_confirmed(self, _existence: float) -> bool:
        return True

    def survival(self, _before: Belief, _after: Belief) -> float:
        return 1.0

    def after(self, existence: float, confirmed: bool, _own: TrackLooks, _evidence: float) -> "Judged":
        return {"existence": existence, "confirmed": confirmed}

    def is_over(self, _state: "TrackState", _chance: float) -> bool:
        return False


@dataclass(frozen=True)
class BernoulliExistence:
    """An unknown number of targets: each look says something of whether there is one."""

    dt_s: float
    confirmed_above: float  # odds of r
    range_max_km: float  # of the field of view

    def at_birth(self, limit: float, r: float, n_cell: int) -> float:
        # However many looks the search makes in a dwell, it meets as many targets and makes as many false alarms.
        p_fa, u = p_fa_of(limit, n_cell), p_fa_of(2.0 * r * r, n_cell)
        return self._existence(exp(_log_odds_at_birth(min(u / p_fa, 1.0), self.dt_s)))

    def is_confirmed(self, existence: float) -> bool:
        return _odds(existence) > self.confirmed_above

    def survival(self, before: Belief, after: Belief) -> float:
        # What had left before has been counted.
        stays = min(self._inside(after) / max(self._inside(before), _TINY), 1.0)
        return stays * exp(-self.dt_s / SURVIVES_S)

    def after(self, existence: float, confirmed: bool, own: TrackLooks, evidence: float) -> "Judged":
        ratio = UNSEEN
        if own.is_hit:
            ratio = hit_ratio(own.p_fa, own.u)
        elif own.is_looked:
            ratio = miss_ratio(evidence, own.unresolved, 0.0 if own.is_unmeasured or own.is_stale else LEAST_P_D)
        elif own.is_unmeasured or own.is_stale:
            ratio = 1.0
        existence = self._existence(_odds(existence) * ratio)
        confirmed = self.is_confirmed(existence) or (confirmed and existence > DOUBTED_BELOW)
        return {"existence": existence, "confirmed": confirmed}

    def is_over(self, state: "TrackState", chance: float) -> bool:
        return state.existence * chance < ENDED_BELOW

    def _inside(self, belief: Belief) -> float:
        """Probability that the target, if there is one, is in the field of view."""
        return _share_within(belief.sample(), self.range_max_km)

    def _existence(self, odds: float) -> float:
        odds = min(odds, max(MOST_ODDS, 10.0 * self.confirmed_above))
        return odds / (1.0 + odds)


def existence_of(radar: RadarConfig) -> Existence:
    """Of the tracks of a radar."""
    initiation, dt_s = radar.initiation, radar.motion.dt_s
    if initiation is None:
        return CertainExistence()
    per_dwell = initiation.false_tracks_per_hour * dt_s / SECONDS_PER_HOUR
    bound = _confirmed_above(min(per_dwell / ALERTS, 1.0), dt_s)
    return BernoulliExistence(dt_s, exp(bound), radar.acquisition.range_max_km)


@kernel
def _share_within(states: NDArray[np.float64], range_km: float) -> float:
    """Share of states, (n, 4), in front of the array and not beyond a range."""
    count = 0
    for i in range(states.shape[0]):
        x, y = states[i, 0], states[i, 2]
        count += x > 0.0 and x * x + y * y <= range_km * range_km
    return float(count / states.shape[0])


def alert_p_fa(n_look: int) -> float:
    """P_FA of each of n looks of the search in a dwell, and of the looks of a tentative track together."""
    return min(ALERTS / max(n_look, 1), MOST_P_FA)


def p_fa_of(limit: float, n: int) -> float:
    """P_FA of looks: that one of n cells without a target is over their limit."""
    return max(-expm1(n * log1p(-min(exp(-0.5 * limit), 0.5))), _TINY)


def hit_ratio(p_fa: float, u: float) -> float:
    """L(u) of a detection in looks whose P_FA, together, is this; u: as in the first lines."""
    return exp(_log_ratio(min(u / p_fa, 1.0), p_fa))


def miss_ratio(evidence: float, unresolved: float = 0.0, least_p_d: float = LEAST_P_D) -> float:
    """Likelihood ratio of looks without a detection, to which the belief gives this probability.

    unresolved : probability that the echo is in the cell of another target's: then it has no detection of its own
    least_p_d  : by which the miss is judged at least; 0 if not all of the looks were measured, for the target may be
                 in the others
    """
    missed = min(max(evidence, 1.0 - MOST_P_D), 1.0 - least_p_d)
    return unresolved + (1.0 - unresolved) * missed


def _log_ratio(share: float, p_fa: float) -> float:
    """ln L(u); share = u / P_FA."""
    return log(MOST_P_D * KAPPA / p_fa) + (KAPPA - 1.0) * log(max(share, _TINY))


def _log_odds_at_birth(share: float, dt_s: float) -> float:
    return log(UNDETECTED_PER_S * dt_s / ALERTS) + _log_ratio(share, 1.0)


def _odds(existence: float) -> float:
    return existence / max(1.0 - existence, _TINY)


@lru_cache(maxsize=64)
def _confirmed_above(chance: float, dt_s: float) -> float:
    """Log odds above which a track of noise is confirmed with this probability, once a detection has begun it.

    Its looks have the P_FA of a search with `_LOOKS` looks, and find a target with `_P_D`. Both matter little: with a
    smaller P_FA detections of noise are rarer and each says more.
    """
    low, high = log(ENDED_BELOW), log(_HIGHEST)
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _confirmed(middle, alert_p_fa(_LOOKS), dt_s) > chance else (low, middle)
    return high


def _confirmed(bound: float, p_fa: float, dt_s: float) -> float:
    """Probability that the log odds of a track of noise ever exceed the bound, in looks with this P_FA.

        f(l) = P_FA E[f(l + ln L(u))] + (1 - P_FA) f(l + ln(1 - P_D)),   f = 1 above the bound, 0 where tracks end

    solved on an even grid of l.
    """
    ended = log(ENDED_BELOW / (1.0 - ENDED_BELOW))
    n = max(round((bound - ended) / _STEP), 1)
    edges = ended + (bound - ended) * np.arange(n + 1) / n
    centres = 0.5 * (edges[1:] + edges[:-1])
    rises = _exceeds(edges - centres[:, np.newaxis], _log_ratio(1.0, p_fa))  # (n, n + 1)
    moves = p_fa * (rises[:, :-1] - rises[:, 1:])
    falls = np.searchsorted(edges, centres + log(1.0 - _P_D), side="right") - 1
    missed = np.flatnonzero(falls >= 0)
    moves[missed, falls[missed]] += 1.0 - p_fa
    confirmed = solve(np.eye(n) - moves, p_fa * rises[:, -1])
    first = _exceeds(edges, _log_odds_at_birth(1.0, dt_s))
    return inner(first[:-1] - first[1:], confirmed) + float(first[-1])


def _exceeds(log_odds: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Probability that least + (kappa - 1) ln s exceeds these, s even in 0 .. 1."""
    return elementwise.exp(np.minimum((least - log_odds) / (1.0 - KAPPA), 0.0))
