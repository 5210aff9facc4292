"""Whether there is a target: how a track of an unknown number is confirmed, how long it lives.

A detection of the search begins a tentative track. It is confirmed by M detections within its first N looks, that one
included; where there is nothing, each look is over its limit with probability p, so that the expected number of false
tracks in a dwell of n search looks is

    n p P(Binomial(N - 1, p) >= M - 1)

which is solved for p. A look is the track's own: of the search, whose beams step on beside it, a detection serves
the track but confirms nothing, or else false tracks would have more looks than N. From then on r, the probability that
there is a target, decides (integrated filter; Musicki, Evans and Stankovic 1994): a miss in a look that finds the
target with probability P_D, and a detection where false ones have probability p_fa, give

    r / (1 - r)  ->  r / (1 - r) (1 - P_D),      r / (1 - r)  ->  r / (1 - r) P_D / p_fa
"""

from functools import lru_cache
from math import exp, expm1, log1p
from typing import NamedTuple, Self

from scipy.optimize import brentq
from scipy.special import bdtrc

from cogradar.shared.scenario.radar_config import RadarConfig

AT_BIRTH = 0.5  # a detection of the search: as likely a target as none
ENDED_BELOW = 0.1  # of r: the track is given up,
UNFOUND_BELOW = 0.01  # ... or of the probability that a look at its cell would find the target
MOST_ODDS = 1e5  # of r: so many hits are forgotten after some misses in a row
# P_D that a miss is judged by, whatever the belief says: a target that has turned is missed though it is strong; and
# one whose echoes are not known would seem weaker with each miss, so that what is not there would never be given up.
LEAST_P_D, MOST_P_D = 0.3, 0.9
MOST_P_FA = 0.1  # of a look
SECONDS_PER_HOUR = 3600.0


class Confirmation(NamedTuple):
    """When a tentative track is confirmed, and when given up."""

    confirmations: int  # M
    window: int  # N

    @classmethod
    def of(cls, radar: RadarConfig) -> Self:
        """As a radar has it. ValueError if its number of tracks is known."""
        if radar.initiation is None:
            raise ValueError("the number of tracks is known: nothing is searched")
        return cls(radar.initiation.confirmations, radar.initiation.window)

    def is_confirmed(self, n_hit: int) -> bool:
        """Whether so many detections are enough."""
        return n_hit >= self.confirmations

    def has_failed(self, n_look: int, n_hit: int) -> bool:
        """Whether what is left of the window cannot bring enough of them."""
        return n_hit + self.window - n_look < self.confirmations


def alert_p_fa(radar: RadarConfig, isotropic: float) -> float:
    """P_FA of each look of the search in a dwell, and of those that confirm what they found.

    As many false tracks as `radar.initiation` says; fewer, where it would take more than one alert in ten looks.

    isotropic : power in all directions; with any, each bin is searched, else where the beams of the search are
    """
    initiation, search = radar.initiation, radar.search
    if initiation is None or search is None:
        raise ValueError("the number of tracks is known: nothing is searched")
    rate = initiation.false_tracks_per_hour * radar.motion.dt_s / SECONDS_PER_HOUR
    n_look = radar.array.n_bin if isotropic > 0.0 else search.beams
    return _alert(rate, n_look, initiation.confirmations, initiation.window)


@lru_cache(maxsize=64)
def _alert(rate: float, n_look: int, confirmations: int, window: int) -> float:
    def excess(p: float) -> float:
        return float(n_look * p * bdtrc(confirmations - 2, window - 1, p)) - rate

    return MOST_P_FA if excess(MOST_P_FA) <= 0.0 else float(brentq(excess, 0.0, MOST_P_FA, xtol=1e-15, rtol=1e-12))


def p_fa_of(limit: float, n: int) -> float:
    """P_FA of looks: that one of n cells without a target is over their limit."""
    return max(-expm1(n * log1p(-min(exp(-0.5 * limit), 0.5))), 1e-300)


def after_miss(existence: float, evidence: float) -> float:
    """r after a look without a detection, which the belief gives this probability."""
    return _existence(_odds(existence) * min(max(evidence, 1.0 - MOST_P_D), 1.0 - LEAST_P_D))


def after_hit(existence: float, p_fa: float) -> float:
    """r after a detection in looks whose P_FA, together, is this."""
    return _existence(_odds(existence) * MOST_P_D / p_fa)


def _odds(existence: float) -> float:
    return min(existence / max(1.0 - existence, 1e-300), MOST_ODDS)


def _existence(odds: float) -> float:
    odds = min(odds, MOST_ODDS)
    return odds / (1.0 + odds)
