"""How strong the detections of a target are, by what the radar assumes of its RCS: one law for each name.

Symbols: u = |alpha|/sigma, of the mean RCS if it fluctuates; r = |alpha_hat|/sigma with density f(r | u).

Swerling I, an echo of exponential power: alpha ~ CN(0, |alpha|^2), so that alpha_hat is complex normal as well,

    f(r | u) = 2 r / m exp(-r^2 / m),  P(low <= r < high | u) = exp(-low^2 / m) - exp(-high^2 / m),  m = 1 + u^2

It is used for Swerling III, too: of the same mean, P_D then errs by at most .13.

Of a target whose RCS is not known, what its echoes were tells how strong they will be. The track keeps E, a smoothed
|alpha|^2 as of Swerling I: the echo itself, not the RCS, which would need a measured range.
"""

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import exp, expm1, i0e, log, squared_modulus
from cogradar.shared.numerics.quadrature import gauss_legendre

Floats = NDArray[np.float64]

MEMORY = 1.0 / 16.0  # weight of the newest look in E: an error of .8 dB; 13 dB in 300 dwells are followed within .7 dB
MOST = 8.0  # r^2 of a detection, over its mean 1 + u^2, counts up to here: exp(-8), an echo that is another target's
_STEPS, _TINY = 30, 1e-12
_GAUSS_NODES, _GAUSS_WEIGHTS = gauss_legendre(24)


class EchoLaw(NamedTuple):
    """What is known of r given u."""

    log_likelihood: Callable[[Floats, Floats], Floats]  # (r, u) -> log f(r | u) - log 2 r; broadcasts, finite
    log_band: Callable[[float, float, Floats], Floats]  # (low, high, u) -> log P(low <= r < high | u); finite
    fluctuates: bool = False  # as of Swerling I; f then has a long tail in u
    tells_range: bool = True  # u is known at each range; else of the track as a whole, and r says where, not how far

    def amplitude(self, at_1_km: float, echo: float) -> float:  # noqa: ARG002
        """|alpha| of the mean RCS at a range of 1 km; at any range, if that does not tell it."""
        return at_1_km

    def mean_echo(self, at_range: float, learned: float) -> float:  # noqa: ARG002
        """Mean |alpha|^2 of a target whose |alpha| is this at its range, or is learned by its track."""
        return at_range**2

    def of_range(self, log_likelihood: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
        """What amplitudes with this likelihood, (n,) km -> (n,), say of the range."""
        return log_likelihood

    def first_echo(
        self,
        alpha_hat: NDArray[np.complexfloating],  # noqa: ARG002
        sigma_hat: Floats,  # noqa: ARG002
        own: NDArray[np.bool_],  # noqa: ARG002
        least: float,  # noqa: ARG002
    ) -> float:
        """E of a track after its acquisition; 0 if the RCS is assumed. Arguments as of `first_echo`."""
        return 0.0

    def echo_after_hit(self, echo: float, r: float, sigma: float, least: float) -> float:  # noqa: ARG002
        """E of a track after a detection of amplitude r; `least` or more, if it is learned."""
        return echo

    def echo_after_miss(
        self,
        echo: float,
        limit: float,  # noqa: ARG002
        sigma: Floats,  # noqa: ARG002
        shares: Callable[[], Floats],  # noqa: ARG002
        least: float,  # noqa: ARG002
    ) -> float:
        """E of a track after looks in vain, `shares` the chance that its target is in each."""
        return echo


class UnknownRcs(EchoLaw):
    """Swerling I, of an echo whose mean the track learns: its range tells nothing of it."""

    def amplitude(self, at_1_km: float, echo: float) -> float:  # noqa: ARG002
        return sqrt(echo)

    def mean_echo(self, at_range: float, learned: float) -> float:  # noqa: ARG002
        return learned

    def of_range(self, log_likelihood: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:  # noqa: ARG002
        return np.zeros_like

    def first_echo(
        self, alpha_hat: NDArray[np.complexfloating], sigma_hat: Floats, own: NDArray[np.bool_], least: float
    ) -> float:
        return first_echo(alpha_hat, sigma_hat, own, least)

    def echo_after_hit(self, echo: float, r: float, sigma: float, least: float) -> float:
        return max(echo_after_hit(echo, r, sigma), least)

    def echo_after_miss(
        self, echo: float, limit: float, sigma: Floats, shares: Callable[[], Floats], least: float
    ) -> float:
        return max(echo_after_miss(echo, limit, sigma, shares()), least)


def log_rice_likelihood(r: Floats, u: Floats) -> Floats:
    """Log of the Rice density of r given u, without the factor 2 r that u does not enter; broadcasts.

    f(r | u) = 2 r exp(-(r^2 + u^2)) I_0(2 r u) = 2 r exp(-(r - u)^2) i0e(2 r u): finite for any r, u >= 0
    """
    return np.asarray(log(i0e(2.0 * r * u)) - (r - u) ** 2)


def log_rice_band(low: float, high: float, u: Floats) -> Floats:
    """Log of the Rice density's integral over [low, high), by Gauss's rule: narrow bands, or low = 0."""
    half = 0.5 * (high - low)
    r = low + half * (1.0 + _GAUSS_NODES)
    log_f = log(2.0 * r) + log_rice_likelihood(r, u[..., None])
    top = log_f.max(axis=-1)
    integral = np.sum(exp(log_f - top[..., None]) * _GAUSS_WEIGHTS, axis=-1)
    return np.asarray(np.minimum(top + log(half * integral), 0.0))


def log_swerling_likelihood(r: Floats, u: Floats) -> Floats:
    """Log of the Swerling I density of r given u, without the factor 2 r; broadcasts."""
    mean = 1.0 + u * u
    return np.asarray(-log(mean) - r * r / mean)


def log_swerling_band(low: float, high: float, u: Floats) -> Floats:
    """Log of the Swerling I density's integral over [low, high)."""
    mean = 1.0 + u * u
    return np.asarray(log(-expm1((low * low - high * high) / mean)) - low * low / mean)


LAWS = {  # by `radar.assumes.rcs`
    "known": EchoLaw(log_rice_likelihood, log_rice_band),
    "mean": EchoLaw(log_swerling_likelihood, log_swerling_band, fluctuates=True),
    "unknown": UnknownRcs(log_swerling_likelihood, log_swerling_band, fluctuates=True, tells_range=False),
}


def first_echo(
    alpha_hat: NDArray[np.complexfloating], sigma_hat: Floats, own: NDArray[np.bool_], least: float
) -> float:
    """E of a target from all scans of an acquisition, (n_scan,) each; `least` or more.

    own : the amplitude is the target's; else it is that of noise elsewhere in the bin, below which the target was

    Scans below the threshold count: detections alone are upward fluctuations. The most probable E of Swerling I, by the
    EM algorithm; it begins with the mean of |alpha_hat|^2 - sigma_hat^2, which it is if all amplitudes are the target's
    and equally noisy. Scans with sigma_hat 0 are left out.
    """
    used = sigma_hat > 0.0
    variance, own = sigma_hat[used] ** 2, own[used]
    r_sq = squared_modulus(alpha_hat[used]) / variance
    echo, is_own = max(float(np.mean(variance * (r_sq - 1.0))), least), bool(own.all())
    for _ in range(_STEPS):
        expected = r_sq if is_own else np.where(own, r_sq, _mean_below(r_sq, 1.0 + echo / variance))
        echo = max(float(_expected_echo(echo, expected, variance).mean()), least)
    return echo


def echo_after_hit(echo: float, r: float, sigma: float) -> float:
    """E after a detection of amplitude r."""
    r_sq = min(r * r, MOST * (1.0 + echo / sigma**2))
    return echo + MEMORY * float(_expected_echo(echo, r_sq, sigma**2) - echo)


def echo_after_miss(echo: float, threshold: float, sigma: Floats, share: Floats) -> float:
    """E after cells were found empty, (n,) with this sigma and this chance, by now, that the target is in each."""
    r_sq = _mean_below(np.array(0.5 * threshold), 1.0 + echo / sigma**2)
    return echo + MEMORY * float(np.sum(share * (_expected_echo(echo, r_sq, sigma**2) - echo)))


def _mean_below(bound: Floats, mean: Floats) -> Floats:
    """Mean of an exponential r^2 with this mean that is below a bound; broadcasts."""
    return np.asarray(mean - bound / expm1(np.clip(bound / mean, _TINY, 700.0)))


def _expected_echo(echo: float, r_sq: Floats | float, variance: Floats | float) -> Floats:
    """Mean of |alpha|^2 of Swerling I given r^2, sigma^2 (g^2 r^2 + g) with g = u^2/(1 + u^2); broadcasts.

    Its mean over r is E itself: in the mean a look changes nothing. It is a step of the EM algorithm, which goes uphill
    in the likelihood (Dempster et al. 1977).
    """
    g = echo / (echo + variance)
    return np.asarray(variance * (g * g * r_sq + g))
