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

from dataclasses import dataclass, replace
from functools import lru_cache
from math import exp, expm1, log1p
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from scipy.optimize import brentq
from scipy.special import bdtrc

from cogradar.shared.scenario.radar_config import RadarConfig

if TYPE_CHECKING:
    from cogradar.shared.tracking.model import TrackState

AT_BIRTH = 0.5  # a detection of the search: as likely a target as none
ENDED_BELOW = 0.1  # of r: the track is given up,
UNFOUND_BELOW = 0.01  # ... or of the probability that a look at its cell would find the target
MOST_ODDS = 1e5  # of r: so many hits are forgotten after some misses in a row
# P_D that a miss is judged by, whatever the belief says: a target that has turned is missed though it is strong; and
# one whose echoes are not known would seem weaker with each miss, so that what is not there would never be given up.
LEAST_P_D, MOST_P_D = 0.3, 0.9
MOST_P_FA = 0.1  # of a look
SECONDS_PER_HOUR = 3600.0


class TrackLooks(NamedTuple):
    """The looks that were made for a track of an unknown number: what says whether there is a target at all."""

    is_looked: bool = False  # there was one,
    is_found: bool = False  # ... with a detection, and the track has one
    p_fa: float = 1.0  # that they have a false one, by the limit of the track's detection; 1 without one


class Existence(Protocol):
    """How the tracks of a run know whether there is a target."""

    def after(self, state: "TrackState", own: TrackLooks, evidence: float) -> "TrackState":
        """The state with what a dwell says of it. `state.detected` is of that dwell, `evidence` of its observation."""

    def is_over(self, state: "TrackState", chance: float) -> bool:
        """Whether a track is to be given up.

        chance : probability that the target, if there is one, is in the cell where it is most probable
        """


class CertainExistence:
    """Announced targets: there is one of each track, whatever is missed."""

    def after(self, state: "TrackState", _own: TrackLooks, _evidence: float) -> "TrackState":
        return state

    def is_over(self, _state: "TrackState", _chance: float) -> bool:
        return False


@dataclass(frozen=True)
class JudgedExistence:
    """An unknown number of targets: each look says something of whether there is one."""

    confirmations: int  # M
    window: int  # N
    range_max_km: float  # of the field of view

    def is_confirmed(self, n_hit: int) -> bool:
        """Whether so many detections are enough."""
        return n_hit >= self.confirmations

    def has_failed(self, n_look: int, n_hit: int) -> bool:
        """Whether what is left of the window cannot bring enough of them."""
        return n_hit + self.window - n_look < self.confirmations

    def after(self, state: "TrackState", own: TrackLooks, evidence: float) -> "TrackState":
        existence = after_hit(state.existence, own.p_fa) if state.detected else after_miss(state.existence, evidence)
        state = replace(state, existence=existence)
        if state.confirmed:
            return state
        n_look, n_hit = state.n_look + own.is_looked, state.n_hit + own.is_found
        return replace(state, n_look=n_look, n_hit=n_hit, confirmed=self.is_confirmed(n_hit))

    def is_over(self, state: "TrackState", chance: float) -> bool:
        """No look would find its target, or it has flown out of the field of view."""
        x, _, y, _ = state.belief.sample().T
        is_out = (x == 0.0) | (np.hypot(x, y) > self.range_max_km)
        if float(is_out.mean()) > 0.5:
            return True
        if not state.confirmed:
            # Without a look, too: a tentative track that is never lit again would explain what the search finds.
            return self.has_failed(state.n_look, state.n_hit) or state.n_missed >= self.window
        return state.existence < ENDED_BELOW or state.existence * chance < UNFOUND_BELOW


def existence_of(radar: RadarConfig) -> Existence:
    """Of the tracks of a radar."""
    said = radar.initiation
    if said is None:
        return CertainExistence()
    return JudgedExistence(said.confirmations, said.window, radar.acquisition.range_max_km)


def alert_p_fa(radar: RadarConfig, n_look: int) -> float:
    """P_FA of each look of the search in a dwell, and of those that confirm what they found.

    As many false tracks as `radar.initiation` says; fewer, where it would take more than one alert in ten looks.

    n_look : of the search in the dwell, 0: as for one; each bin is one where power goes in all directions
    """
    initiation = radar.initiation
    if initiation is None:
        raise ValueError("the number of tracks is known: nothing is searched")
    rate = initiation.false_tracks_per_hour * radar.motion.dt_s / SECONDS_PER_HOUR
    return _alert(rate, max(n_look, 1), initiation.confirmations, initiation.window)


@lru_cache(maxsize=1024)
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
