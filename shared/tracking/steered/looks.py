"""What a dwell tells a track whose cells are steered, and how probable that is.

A look is a cell in any direction nu_c. What it says depends on where in its main lobe the target is; no border is.

Symbols: d = nu - nu_c; D_T D_R two-way loss of an echo off the axis of its cell, D(d) = |sin(pi N d)/(N sin(pi d))|;
u = |alpha(R)| D_T D_R / sigma; nu_hat, R_hat direction and range of a detection, where the receiver measures them.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shared.numerics.jit import inlined
from shared.scenario.limits import KEPT_LOOKS, LOOKS_ROW
from shared.signal.array import spatial_frequency
from shared.signal.monopulse import off_axis_loss as one_way_loss
from shared.signal.radar_equation import amplitude
from shared.tracking.sensor import Observation, Sensor, interpolate, likelihood_table

Floats = NDArray[np.float64]

FAR_KM = 1e9  # beyond any target: the end of a gate that is open
_LOSS_NODES = 512  # of D_T D_R from the axis to the first null; linear interpolation errs by 5e-6


class Aperture(NamedTuple):
    """What the loss off axis and the measurements depend on."""

    n_tx: int
    n_rx: int
    range_cell_km: float  # 0: ranges are not measured

    @property
    def lobe(self) -> float:
        """From the axis of a cell to its first null, in nu. Nothing is received beyond."""
        return 1.0 / self.n_rx


class Looks(NamedTuple):
    """The looks of one dwell, at most one of them with the track's detection."""

    aperture: Aperture
    hit: int  # which look has it; -1: none
    amplitude: float  # r = |alpha_hat| / sigma of the detection; 0 without one
    nu_hat: float  # its direction,
    nu_sigma: float  # ... and the standard deviation of that; 0: not measured
    range_km: float  # centre of its range cell; 0: not measured
    nus: Floats  # (c,) directions
    sigma: Floats  # (c,) > 0, standard deviation of alpha_hat
    limit: float  # what the statistic was compared with
    low_km: float  # the gate: ranges that were tested
    high_km: float

    @property
    def is_hit(self) -> bool:
        """Whether a look has the track's detection."""
        return self.hit >= 0

    @property
    def hit_sigma(self) -> float:
        """Standard deviation of alpha_hat of the detection."""
        return float(self.sigma[self.hit])


class SteeredLikelihood(NamedTuple):
    """P(looks | state) for kernels; a Gaussian of a measurement is 1 at its top."""

    hit: int
    nus: Floats  # (c,)
    gains: Floats  # (c,) |alpha|/sigma at 1 km on axis
    lobe: float
    loss: Floats  # (n,) D_T D_R from the axis to `lobe`
    low_km: float  # of a detection whose range is measured its range cell, else the gate
    high_km: float
    nu_hat: float
    nu_precision: float  # 1/variance; 0: not measured
    hit_start: float  # table of log P(r | u); empty: the amplitude is not believed
    hit_log_p: Floats
    miss_start: float  # table of log(1 - P_D(u))
    miss_log_p: Floats
    is_log: bool  # both over ln u instead of u
    by_range: bool  # u falls with the range; else gains are |alpha|/sigma at any range


def missed_looks(aperture: Aperture, nus: Floats, sigma: Floats, limit: float, gate_km: tuple[float, float]) -> Looks:
    """Looks without a detection, (c,) directions and standard deviations."""
    return Looks(aperture, -1, 0.0, 0.0, 0.0, 0.0, nus, sigma, limit, *gate_km)


def off_axis_loss(aperture: Aperture, d: ArrayLike) -> Floats:
    """D_T D_R of echoes off the axis of a cell by d in nu, 0 beyond the main lobe; (...) -> (...)."""
    d = np.abs(np.asarray(d, dtype=np.float64))
    received = one_way_loss(d, aperture.n_rx)
    sent = received if aperture.n_tx == aperture.n_rx else one_way_loss(d, aperture.n_tx)
    return np.where(d < aperture.lobe, sent * received, 0.0)


@lru_cache(maxsize=16)
def loss_table(aperture: Aperture) -> Floats:
    """D_T D_R at equal steps from the axis to the first null, (n,)."""
    d = np.linspace(0.0, aperture.lobe, _LOSS_NODES + 1)
    return np.append(off_axis_loss(aperture, d[:-1]), 0.0)


def shares_looked_at(looks: Looks, particles: Floats) -> Floats:
    """Share of a belief, (n, 4), in half of the lobe of each look and within its gate, (c,)."""
    range_km = np.hypot(particles[:, 0], particles[:, 2])
    is_near = np.abs(spatial_frequency(particles) - looks.nus[:, np.newaxis]) < 0.5 * looks.aperture.lobe
    return np.asarray((is_near & (range_km >= looks.low_km) & (range_km < looks.high_km)).mean(axis=1))


def likelihood_of(sensor: Sensor, looks: Looks) -> SteeredLikelihood:
    """How probable these looks are for a target in any state."""
    aperture = looks.aperture
    limited, nothing = sensor._replace(threshold=looks.limit or sensor.threshold), np.zeros(sensor.n_bin)  # 0: no looks
    missed = likelihood_table(limited, Observation(-1, 0.0, nothing))
    found = likelihood_table(limited, Observation(0, looks.amplitude, nothing)) if looks.is_hit else missed
    low_km, high_km, half_km = looks.low_km, looks.high_km, 0.5 * aperture.range_cell_km
    if looks.is_hit and looks.range_km > 0.0 < half_km:
        low_km, high_km = looks.range_km - half_km, looks.range_km + half_km
    return SteeredLikelihood(
        hit=looks.hit,
        nus=looks.nus,
        gains=sensor.amplitude / looks.sigma,
        lobe=aperture.lobe,
        loss=loss_table(aperture),
        low_km=low_km,
        high_km=high_km,
        nu_hat=looks.nu_hat,
        nu_precision=looks.nu_sigma**-2 if looks.nu_sigma > 0.0 else 0.0,
        hit_start=found.start,
        hit_log_p=found.log_p,
        miss_start=missed.start,
        miss_log_p=missed.log_p,
        is_log=missed.is_log,
        by_range=missed.by_range,
    )


def anywhere(likelihood: SteeredLikelihood) -> SteeredLikelihood:
    """Of the detection alone, as if every direction were on axis: what it says of the range."""
    return likelihood._replace(
        hit=0,
        nus=np.zeros(1),
        gains=likelihood.gains[likelihood.hit : likelihood.hit + 1],
        lobe=np.inf,
        loss=np.ones(2),
        nu_precision=0.0,
    )


def of_any_amplitude(likelihood: SteeredLikelihood) -> SteeredLikelihood:
    """Of the detection alone, whatever its amplitude: what it says of direction, and of range where that is measured.

    Where directions are not measured it is in the middle of the main lobe, in which its look would find it.
    """
    hit = likelihood.hit
    nu_hat, nu_precision = likelihood.nu_hat, likelihood.nu_precision
    if nu_precision == 0.0:
        nu_hat, nu_precision = float(likelihood.nus[hit]), 12.0 / likelihood.lobe**2
    return likelihood._replace(
        hit=0,
        nus=likelihood.nus[hit : hit + 1],
        gains=likelihood.gains[hit : hit + 1],
        nu_hat=nu_hat,
        nu_precision=nu_precision,
        hit_log_p=np.empty(0),
    )


@inlined
def probability(x: float, y: float, likelihood: SteeredLikelihood) -> float:
    """P(looks | target at (x, y)), in km.

        hit:   P(r | u) exp(-(nu_hat - nu)^2 / 2 sigma_nu^2) in its range cell, 0 elsewhere
        miss:  1 - P_D(u) for each other look in whose main lobe it is

    Outside of the gate it was not looked at: a miss says nothing there, and a detection is not its own. A target may
    stay in one range cell for many dwells: the errors of its measured range are no independent noise.
    """
    # Taken apart at once: each reading of a field counts the references of all arrays, which was most of the cost.
    hit, nus, gains, lobe, loss, low_km, high_km, nu_hat, nu_precision = likelihood[:9]
    hit_start, hit_log_p, miss_start, miss_log_p, is_log, by_range = likelihood[9:]
    r_sq = x * x + y * y
    range_km = np.sqrt(r_sq)
    if range_km < low_km or range_km >= high_km:
        return 0.0 if hit >= 0 else 1.0
    nu, p = 0.0, 1.0
    if range_km > 0.0:
        nu = 0.5 * y / range_km
    step = (loss.size - 1) / lobe
    for c in range(nus.size):
        position = abs(nu - nus[c]) * step
        is_hit = c == hit
        lost = 0.0
        if position < loss.size - 1:
            i = int(position)
            lost = loss[i] + (position - i) * (loss[i + 1] - loss[i])
        elif not is_hit:
            continue
        u = (amplitude(gains[c], r_sq) if by_range else gains[c]) * lost
        if not is_hit:
            p *= interpolate(u, miss_start, miss_log_p, is_log)
        elif hit_log_p.size > 0:
            p *= interpolate(u, hit_start, hit_log_p, is_log)
    if hit >= 0:
        d_nu = nu - nu_hat
        p *= np.exp(-0.5 * d_nu * d_nu * nu_precision)
    return p


def row_of(looks: Looks, nu: float) -> Floats:
    """Looks without a detection as numbers to be remembered, (LOOKS_ROW,): the KEPT_LOOKS nearest to this direction."""
    row, nearest = np.zeros(LOOKS_ROW), np.argsort(np.abs(looks.nus - nu), kind="stable")[:KEPT_LOOKS]
    row[:3] = looks.limit, looks.low_km, looks.high_km
    row[3 : 3 + nearest.size] = looks.nus[nearest]
    row[3 + KEPT_LOOKS : 3 + KEPT_LOOKS + nearest.size] = looks.sigma[nearest]
    return row


def looks_of(aperture: Aperture, row: Floats) -> Looks:
    """The looks without a detection that `row_of` remembered."""
    sigma = row[3 + KEPT_LOOKS :]
    is_look = sigma > 0.0
    limit, low_km, high_km = row[:3].tolist()
    nus = row[3 : 3 + KEPT_LOOKS][is_look]
    return missed_looks(aperture, nus, sigma[is_look], limit, (low_km, high_km))
