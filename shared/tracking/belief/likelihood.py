"""What a dwell tells a track: its looks, and how probable they are for a target in any state.

Symbols: d = nu - nu_c direction of the target off the axis of a look; D_T D_R two-way loss there (`response`);
u = |alpha(R)| D_T D_R / sigma; r = |alpha_hat|/sigma; nu_hat, R_hat direction and range of a detection, where the
receiver measures them.
"""

from typing import NamedTuple

import numpy as np

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.jit import inlined
from cogradar.shared.signal.angle import apart
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.signal.radar_equation import strength
from cogradar.shared.signal.response import FAR_KM, Response
from cogradar.shared.tracking.sensor import Floats, Sensor, hit_table, interpolate, miss_table


class Looks(NamedTuple):
    """The looks of one dwell, at most one of them with the track's detection."""

    response: Response
    hit: int  # which look has it; -1: none
    amplitude: float  # r of the detection, up to MAX_AMPLITUDE; 0 without one
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

    @property
    def hit_nu(self) -> float:
        """Direction of the look with the detection."""
        return float(self.nus[self.hit])

    @property
    def hit_bin(self) -> int:
        """Bin of the detection; -1 without one."""
        return int(angle_bin(self.hit_nu, self.response.n_bin)) if self.is_hit else -1


class Likelihood(NamedTuple):
    """P(looks | state) for kernels; a Gaussian of a measurement is 1 at its top.

    Tables are of log P over u, or over ln u, equally spaced. A detection of no amplitude has an empty one.
    """

    hit: int  # -1: a miss
    gains: Floats  # (c,) |alpha|/sigma at 1 km on axis, or at any range
    is_box: bool  # a look hears its bin, and nothing else
    hit_bin: int  # bin of the detection, if so; else -1
    bin_gains: Floats  # (n_bin,) of the look that hears each bin, 0: none; of lobes none is
    nus: Floats  # (c,)
    lobe: float
    loss: Floats  # (n,) D_T D_R from the axis to `lobe`
    low_km: float  # of a detection whose range is measured its range cell, else the gate
    high_km: float
    nu_hat: float
    nu_precision: float  # 1/variance; 0: not measured
    hit_start: float  # table of log P(r | u)
    hit_log_p: Floats
    miss_start: float  # table of log(1 - P_D(u))
    miss_log_p: Floats
    is_log: bool  # both over ln u instead of u; they go on as at their ends
    by_range: bool  # u falls with the range; else gains are |alpha|/sigma at any range
    foreign: float = 0.0  # added to a detection's wherever the target is: the echo may be of another one
    is_in_front: bool = True  # a detection is of a target in front of the array (`resampling.weigh`)


def missed_looks(response: Response, nus: Floats, sigma: Floats, limit: float, gate_km: tuple[float, float]) -> Looks:
    """Looks without a detection, (c,) directions and standard deviations."""
    return Looks(response, -1, 0.0, 0.0, 0.0, 0.0, nus, sigma, limit, *gate_km)


def found_look(
    response: Response,
    nu: float,
    sigma: float,
    limit: float,
    r: float,
    measured: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gate_km: tuple[float, float] = (0.0, FAR_KM),
) -> Looks:
    """A look with a detection of amplitude r; `measured`: its direction, the standard deviation of that, range."""
    return Looks(response, 0, r, *measured, np.array([nu]), np.array([sigma]), limit, *gate_km)


def shares_looked_at(looks: Looks, particles: Floats) -> Floats:
    """Share of a belief, (n, 4), that each look would most probably find, (c,)."""
    range_km = hypot(particles[:, 0], particles[:, 2])
    is_tested = (range_km >= looks.low_km) & (range_km < looks.high_km)
    return looks.response.shares(looks.nus, spatial_frequency(particles), is_tested)


def likelihood_of(sensor: Sensor, looks: Looks) -> Likelihood:
    """How probable these looks are for a target in any state."""
    response = looks.response
    limited = sensor._replace(threshold=looks.limit or sensor.threshold)  # 0: no looks
    miss_start, miss_log_p = miss_table(limited)
    hit_start, hit_log_p = hit_table(limited, looks.amplitude) if looks.is_hit else (0.0, np.empty(0))
    low_km, high_km = looks.low_km, looks.high_km
    if looks.range_km > 0.0:
        half_km = 0.5 * response.range_cell_km
        low_km, high_km = looks.range_km - half_km, looks.range_km + half_km
    gains, bin_gains = sensor.amplitude / looks.sigma, np.zeros(response.n_bin)
    if response.is_box:
        bin_gains[angle_bin(looks.nus, response.n_bin)] = gains
    return Likelihood(
        hit=looks.hit,
        gains=gains,
        is_box=response.is_box,
        hit_bin=looks.hit_bin if response.is_box else -1,
        bin_gains=bin_gains,
        nus=looks.nus,
        lobe=response.lobe,
        loss=response.loss_table(),
        low_km=low_km,
        high_km=high_km,
        nu_hat=looks.nu_hat,
        nu_precision=looks.nu_sigma**-2 if looks.nu_sigma > 0.0 else 0.0,
        hit_start=hit_start,
        hit_log_p=hit_log_p,
        miss_start=miss_start,
        miss_log_p=miss_log_p,
        is_log=sensor.law.fluctuates,
        by_range=sensor.law.tells_range,
    )


def anywhere(likelihood: Likelihood) -> Likelihood:
    """Of the detection alone, as if every direction were on axis: what it says of the range."""
    return likelihood._replace(
        hit=0,
        gains=likelihood.gains[likelihood.hit : likelihood.hit + 1],
        is_box=False,
        nus=np.zeros(1),
        lobe=np.inf,
        loss=np.ones(2),
        nu_precision=0.0,
        is_in_front=not likelihood.is_box,
    )


def of_any_amplitude(likelihood: Likelihood) -> Likelihood:
    """Of the detection alone, whatever its amplitude: what it says of direction, and of range where that is measured.

    Where directions are not measured it is in the middle of the main lobe, in which its look would find it.
    """
    hit = likelihood.hit
    if likelihood.is_box:
        return likelihood._replace(hit_log_p=np.empty(0))
    nu_hat, nu_precision = likelihood.nu_hat, likelihood.nu_precision
    if nu_precision == 0.0:
        nu_hat, nu_precision = float(likelihood.nus[hit]), 12.0 / likelihood.lobe**2
    return likelihood._replace(
        hit=0,
        gains=likelihood.gains[hit : hit + 1],
        nus=likelihood.nus[hit : hit + 1],
        nu_hat=nu_hat,
        nu_precision=nu_precision,
        hit_log_p=np.empty(0),
    )


@inlined
def in_lobes(
    x: float,
    y: float,
    hit: int,
    gains: Floats,
    nus: Floats,
    lobe: float,
    loss: Floats,
    low_km: float,
    high_km: float,
    nu_hat: float,
    nu_precision: float,
    hit_start: float,
    hit_log_p: Floats,
    miss_start: float,
    miss_log_p: Floats,
    is_log: bool,
    by_range: bool,
) -> float:
    """P(steered looks | target at (x, y)), in km.

        hit:   P(r | u) exp(-(nu_hat - nu)^2 / 2 sigma_nu^2) in its range cell, 0 elsewhere
        miss:  1 - P_D(u) for each other look in whose main lobe it is

    Outside of the gate it was not looked at: a miss says nothing there, and a detection is not its own. A target may
    stay in one range cell for many dwells: the errors of its measured range are no independent noise.

    The arguments are fields of a `Likelihood`. A kernel takes it apart once: each reading of a field counts the
    references of all arrays, which would be most of the cost.
    """
    r_sq = x * x + y * y
    range_km = np.sqrt(r_sq)
    if range_km < low_km or range_km >= high_km:
        return 0.0 if hit >= 0 else 1.0
    nu, p = 0.0, 1.0
    if range_km > 0.0:
        nu = 0.5 * y / range_km
    step = (loss.size - 1) / lobe
    for c in range(nus.size):
        position = apart(nu, nus[c]) * step
        is_hit = c == hit
        lost = 0.0
        if position < loss.size - 1:
            i = int(position)
            lost = loss[i] + (position - i) * (loss[i + 1] - loss[i])
        elif not is_hit:
            continue
        u = strength(gains[c], r_sq, by_range) * lost
        if not is_hit:
            p *= interpolate(u, miss_start, miss_log_p, is_log)
        elif hit_log_p.size > 0:
            p *= interpolate(u, hit_start, hit_log_p, is_log)
    if hit >= 0:
        d_nu = apart(nu, nu_hat)
        p *= np.exp(-0.5 * d_nu * d_nu * nu_precision)
    return p
