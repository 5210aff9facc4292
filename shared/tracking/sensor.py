"""How probable an amplitude is, or that there is none, in a look at a target.

A track is told a detection with its amplitude, or that there was none. How it reads an amplitude is a setting: as the
paper does, by its level, of which it takes the probability; or itself, of which there is only a density. What stands
for it is the probability of an interval as wide as a level around it, sqrt(3) f(r | u). Whatever compares the evidence
of an observation with a bound, such as when a belief is depleted, then means the same for both.

Symbols: alpha echo amplitude, |alpha| = 10^(amplitude_db/20) / (R/km)^2; alpha_hat ~ CN(alpha, sigma^2) its estimate;
u = |alpha|/sigma; r = |alpha_hat|/sigma, which is Rice distributed with density f; lambda the threshold of the
statistic 2 r^2; q the level, |alpha_hat| counted in steps of beta = sqrt(3) sigma. Everything depends on the state
through u alone, so that one small table serves all particles. How r is distributed for a target whose RCS
fluctuates, or is not known, is a law of `cogradar.shared.signal.echo_laws`.
"""

from functools import lru_cache
from math import ceil, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import exp, log, modulus
from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.signal.echo_laws import LAWS, EchoLaw
from cogradar.shared.signal.radar_equation import amplitude_at_1_km

Floats = NDArray[np.float64]
STEP = sqrt(3.0)  # beta/sigma: |alpha_hat - alpha| <= beta with probability 1 - exp(-3) = 0.950
MAX_LEVEL = 2.0**30  # keeps observations within the range of the search's keys; no aircraft comes near it
MAX_AMPLITUDE = MAX_LEVEL * STEP
# Of u, or of ln u. Linear interpolation of log P then errs by |d2 log P/du2|/(8 * 32^2): 2.4e-4, since a Gaussian has
# curvature 2; only at u < 1, where I_0(2 r u) has up to 2 r^2, by 1e-2 of probabilities that are themselves
# below exp(-r^2).
# Over ln u, of a density in r^2/(1 + u^2), it errs by 4 r^2/u^2 / (8 * 32^2) at most: 5e-4 where r is probable.
_NODES_PER_UNIT = 32
_MARGIN = 8.0  # in u, beyond the observed amplitude: probabilities there are below exp(-64)
_LEAST_BAND = 1e-6  # in r; see `level_band`
_LEAST_LOG, _MOST_LOG = -4.0, 24.0  # ln u of tables over it: beyond, P hardly changes, or is not needed


class Sensor(NamedTuple):
    """What the tracker knows of the radar."""

    n_bin: int
    amplitude_db: float  # 20 log10|alpha| at 1 km
    threshold: float  # lambda = -2 ln P_FA
    is_exact: bool = False  # a detection is read by its amplitude itself, not by its level
    rcs: str = "known"  # what is assumed of the target's RCS
    echo: float = 0.0  # if that is nothing: mean |alpha|^2 of this target as its track knows it, wherever it is

    @property
    def amplitude(self) -> float:
        """|alpha| at a range of 1 km, or at any range if that does not tell it (`EchoLaw.tells_range`)."""
        return self.law.amplitude(amplitude_at_1_km(self.amplitude_db), self.echo)

    @property
    def law(self) -> EchoLaw:
        """How the amplitudes of detections are distributed."""
        return LAWS[self.rcs]


def heard(alpha_hat: NDArray[np.complex64]) -> Any:
    """|alpha_hat| as scans have it, in single precision unless it overflows there, as squares do from 1.8e19; (...)."""
    with np.errstate(over="ignore"):
        found = modulus(alpha_hat)
    return modulus(np.asarray(alpha_hat, dtype=np.complex128)) if np.isinf(found).any() else found


@inlined
def level_of(r: float) -> int:
    """Level q of an amplitude r, counted in steps of sqrt(3) up to MAX_LEVEL."""
    return int(min(r / STEP, MAX_LEVEL))


def level_band(level: int, threshold: float) -> tuple[float, float]:
    """Interval of r that a detection with this level stands for: [max(q sqrt 3, sqrt(lambda/2)), (q + 1) sqrt 3).

    A level that lies below the threshold cannot be. Rounding can produce one all the same; it is read as an amplitude
    right at the threshold, so that it still says something about the range.
    """
    low = max(level * STEP, sqrt(0.5 * threshold))
    return low, max((level + 1) * STEP, low + _LEAST_BAND)


def log_level_probability(level: int, threshold: float, u: ArrayLike, rcs: str = "known") -> NDArray[np.float64]:
    """Log probability that a cell is detected with this level, given u. Of a target with a known RCS it is

        P = Q_1(sqrt2 u, sqrt2 low) - Q_1(sqrt2 u, sqrt2 high),  (low, high) = level_band(level, threshold)

    u       : (...) >= 0
    returns : (...) finite

    The Rice density is integrated over the band, since the difference of the two Marcum functions loses all its
    digits in the tails and SciPy's noncentral chi-square fails for strong echoes (u above some hundreds).
    """
    return LAWS[rcs].log_band(*level_band(level, threshold), np.asarray(u, dtype=np.float64))


def log_amplitude_probability(r: float, threshold: float, u: ArrayLike, rcs: str = "known") -> NDArray[np.float64]:
    """Log probability of an interval of r as wide as a level, given u, with the density that there is at r.

        P = sqrt(3) f(r | u)

    r       : at the threshold if it lies below, as for `level_band`
    u       : (...) >= 0
    returns : (...) finite; 0 where rounding, or a threshold of P_FA > 0.03, would make P more than 1
    """
    r = max(r, sqrt(0.5 * threshold))
    log_f = log(2.0 * r) + LAWS[rcs].log_likelihood(np.asarray(r), np.asarray(u, dtype=np.float64))
    return np.asarray(np.minimum(log(STEP) + log_f, 0.0))


def log_hit_probability(sensor: Sensor, amplitude: float, u: ArrayLike) -> NDArray[np.float64]:
    """Log probability of a detection with this amplitude r as the sensor reads it, given u; (...) -> (...)."""
    if sensor.is_exact:
        return log_amplitude_probability(amplitude, sensor.threshold, u, sensor.rcs)
    return log_level_probability(level_of(amplitude), sensor.threshold, u, sensor.rcs)


def log_miss_probability(threshold: float, u: ArrayLike, rcs: str = "known") -> NDArray[np.float64]:
    """Log probability that a cell with a target stays below the threshold, 1 - P_D."""
    return LAWS[rcs].log_band(0.0, sqrt(0.5 * threshold), np.asarray(u, dtype=np.float64))


@lru_cache(maxsize=1024)  # one of 600 numbers per level: 5 MB at most
def _level_table(sensor: Sensor, level: int) -> tuple[float, NDArray[np.float64]]:
    u, start = _nodes(sensor, *level_band(level, sensor.threshold))
    return start, log_level_probability(level, sensor.threshold, u, sensor.rcs)


@lru_cache(maxsize=16)
def _miss_table(sensor: Sensor) -> tuple[float, NDArray[np.float64]]:
    u, start = _nodes(sensor, 0.0, sqrt(0.5 * sensor.threshold))
    return start, log_miss_probability(sensor.threshold, u, sensor.rcs)


@lru_cache(maxsize=16)
def _hit_table(sensor: Sensor) -> tuple[float, NDArray[np.float64]]:
    """Of any detection, whatever its amplitude: log P_D."""
    u, start = _nodes(sensor, 0.0, 0.0)
    return start, sensor.law.log_band(sqrt(0.5 * sensor.threshold), np.inf, u)


def _nodes(sensor: Sensor, low: float, high: float) -> tuple[NDArray[np.float64], float]:
    """Values of u at which amplitudes between these are tabulated, and where the table of these starts."""
    if sensor.law.fluctuates:
        return exp(np.arange(_LEAST_LOG, _MOST_LOG, 1.0 / _NODES_PER_UNIT)), _LEAST_LOG
    start = max(low - _MARGIN, 0.0)
    return start + np.arange(ceil((high + _MARGIN - start) * _NODES_PER_UNIT) + 1) / _NODES_PER_UNIT, start


def miss_table(sensor: Sensor) -> tuple[float, Floats]:
    """Where the table of log(1 - P_D(u)) starts, and the table."""
    return _miss_table(sensor._replace(echo=0.0))  # which no table depends on


def hit_table(sensor: Sensor, amplitude: float) -> tuple[float, Floats]:
    """Where the table of log P(r | u) of a detection with this amplitude starts, and the table."""
    plain = sensor._replace(echo=0.0)
    if not sensor.law.tells_range:
        return _hit_table(plain)
    if not sensor.is_exact:
        return _level_table(plain, level_of(amplitude))
    u, start = _nodes(sensor, amplitude, amplitude)
    return start, log_amplitude_probability(amplitude, sensor.threshold, u, sensor.rcs)


@kernel
def interpolate(u: float, start: float, log_p: NDArray[np.float64], is_log: bool) -> float:
    """Probability at u from a table of its logarithm; outside of a table over u it is 0."""
    if is_log:
        last = (log_p.size - 1) * (1.0 - 1e-12)
        position = min(max((np.log(max(u, 1e-300)) - start) * _NODES_PER_UNIT, 0.0), last)
    else:
        position = (u - start) * _NODES_PER_UNIT
        if position < 0.0 or position >= log_p.size - 1:
            return 0.0
    i = int(position)
    return float(np.exp(log_p[i] + (position - i) * (log_p[i + 1] - log_p[i])))
