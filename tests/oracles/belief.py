"""Slow, obvious versions of the belief update, for the tests."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cogradar.shared.signal.array import angle_bin
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.sensor import Sensor


def level_probability(level: int, threshold: float, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """P(detected with this level | u): 2 r^2 is noncentral chi-square, 2 degrees of freedom, noncentrality 2 u^2."""
    low = max(2.0 * 3.0 * level**2, threshold)
    high = 2.0 * 3.0 * (level + 1) ** 2
    law = stats.ncx2(2, 2.0 * u**2)
    return np.asarray(np.where(2.0 * u**2 > low, law.cdf(high) - law.cdf(low), law.sf(low) - law.sf(high)))


def hit_probability(amplitude: float, sensor: Sensor, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of a detection with this amplitude: its level's, or sqrt 3 times the Rice density of r itself."""
    if not sensor.is_exact:
        return level_probability(int(amplitude / np.sqrt(3.0)), sensor.threshold, u)
    return np.asarray(np.sqrt(3.0) * stats.rice.pdf(amplitude, np.sqrt(2.0) * u, scale=np.sqrt(0.5)))


def miss_probability(threshold: float, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """P(not detected | u)."""
    return np.asarray(stats.ncx2(2, 2.0 * u**2).cdf(threshold))


def likelihood(states: NDArray[np.float64], observation: Looks, sensor: Sensor) -> NDArray[np.float64]:
    """P(observation | state), one state at a time."""
    values, sigma = np.ones(len(states)), np.zeros(sensor.n_bin)
    sigma[angle_bin(observation.nus, sensor.n_bin)] = observation.sigma
    for i, (x, _, y, _) in enumerate(states):
        range_km = np.hypot(x, y)
        centres = np.linspace(-0.5, 0.5, sensor.n_bin)
        bin_ = int(np.argmin(np.abs(centres - 0.5 * y / range_km)))
        if observation.hit_bin not in (-1, bin_):
            values[i] = 0.0
            continue
        if sigma[bin_] == 0.0:
            continue
        u = np.array([10 ** (sensor.amplitude_db / 20) / range_km**2 / sigma[bin_]])
        if observation.hit_bin == bin_:
            values[i] = hit_probability(observation.amplitude, sensor, u)[0]
        else:
            values[i] = miss_probability(sensor.threshold, u)[0]
    return values


class GridBelief(NamedTuple):
    """Exact belief of (x, vx) on a lattice, for a target on boresight; dt = 1 s."""

    x: NDArray[np.float64]  # (n_x,) km, spacing half of that of vx
    vx: NDArray[np.float64]  # (n_v,) km/s
    p: NDArray[np.float64]  # (n_x, n_v), sums to 1

    def predicted(self, sigma_s: float) -> "GridBelief":
        """One dwell later.

        With dv = vx spacing, an acceleration of j dv moves (x, vx) by (vx + j dv/2, j dv): whole steps of the lattice,
        so nothing is interpolated. The sum over j in place of the integral errs by 2 exp(-2 pi^2 (sigma_s/dv)^2).
        """
        dv, dx = self.vx[1] - self.vx[0], self.x[1] - self.x[0]
        reach = round(8.0 * sigma_s / dv)
        p = np.zeros_like(self.p)
        for j in range(-reach, reach + 1):
            weight = stats.norm.pdf(j * dv, scale=sigma_s) * dv
            for c, v in enumerate(self.vx):
                if 0 <= c + j < self.vx.size:
                    p[:, c + j] += weight * shifted(self.p[:, c], round((v + 0.5 * j * dv) / dx))
        return self._replace(p=p / p.sum())

    def conditioned(self, observation: Looks, sensor: Sensor) -> "GridBelief":
        """After an observation."""
        states = np.zeros((self.x.size, 4))
        states[:, 0] = self.x
        p = self.p * likelihood(states, observation, sensor)[:, None]
        return self._replace(p=p / p.sum())

    def mean(self, values: NDArray[np.float64]) -> float:
        """Expectation of a function given on the lattice."""
        return float((self.p * values).sum())


def shifted(column: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
    """Moved up by `steps`; what leaves the grid is dropped."""
    out = np.zeros_like(column)
    n = column.size - abs(steps)
    if steps >= 0:
        out[steps:] = column[:n]
    else:
        out[:n] = column[-steps:]
    return out
