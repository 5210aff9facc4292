"""How well a target's place can be known across the line of sight, and the echo that a wanted accuracy takes.

Symbols: c unit vector across the line of sight; P covariance, v = c^T P c of the place; R range, theta bearing;
zeta = 2 |alpha|^2 / sigma^2 of a look on its axis; kappa^2 power of the noise in the derivative's channel
(`monopulse`).

A detection measures the direction with sigma_nu = 1 / (kappa sqrt zeta), and so the place across with

    s = 2 R sigma_nu / cos theta,   v' = v s^2 / (v + s^2)

Power buys no other accuracy: along the line of sight there is the range cell, as wide for any echo.
"""

from math import hypot, inf, sqrt

from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import across_km
from cogradar.shared.signal.looks import range_cells
from cogradar.shared.signal.monopulse import kappa_sq
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking.belief.gaussian_mixture import GaussianMixture, found_as_expected
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import Floats

Moments = tuple[Floats, Floats]  # mean, (4,), and covariance, (4, 4), of a belief

AIM = 0.85  # of the accuracy that was asked for: amplitudes, and so measured directions, fluctuate
SETTLED = 25  # looks in a row, after which another one changes next to nothing
_NEAR_KM, _END_FIRE = 1e-3, 1e-3
_LEAST, _HALVINGS = 1e-4, 8  # of an echo: as far down as it is looked for, to 4 % of it


def needed_zeta(n_rx: int, predicted: Moments, km: float) -> float:
    """zeta of a detection that leaves the accuracy `km` of a belief predicted for its dwell; 0: no echo is needed."""
    (mean, _), v = predicted, across_km(*predicted) ** 2
    if v <= km * km:
        return 0.0
    range_km = max(hypot(mean[0], mean[2]), _NEAR_KM)
    by_nu = 2.0 * range_km / max(float(mean[0]) / range_km, _END_FIRE)
    return by_nu**2 * (v - km * km) / (km * km * v) / kappa_sq(n_rx)


def settled_km(model: TrackerModel, n_rx: int, belief: Moments, zeta: float) -> float:
    """The least that a target's sigma across the line of sight comes to if each dwell has a detection of this zeta.

    Each detection is where it is expected, so that nothing speaks for a turn, and the target stays as far away.
    """
    mixture, place = GaussianMixture.of_moments(*belief, model.is_mixture), belief[0][:4:2]
    for _ in range(SETTLED):
        mixture = found_as_expected(model, mixture, place, 1.0 / sqrt(kappa_sq(n_rx) * zeta))
    return across_km(*mixture.moments())


def settled_zeta(model: TrackerModel, n_rx: int, belief: Moments, km: float, most: float) -> float:
    """zeta from which on `settled_km` is at most `km`; infinite if it is above `most`."""
    if settled_km(model, n_rx, belief, most) > km:
        return inf
    low, high = _LEAST, 1.0
    for _ in range(_HALVINGS):
        middle = sqrt(low * high)
        low, high = (low, middle) if settled_km(model, n_rx, belief, most * middle) <= km else (middle, high)
    return most * high


def echo_gain(radar: RadarConfig, gain: float, gate: Floats) -> float:
    """zeta of an echo over the power of its beam, of a plan's gain and the ranges that it tests, (2,) km.

    The plan's gain is less, as of a cell whose statistic is compared with the threshold of a single one.
    """
    low_km, high_km = gate.tolist() if gate.any() else radar.acquisition.ranges_km
    n_cell = len(range_cells(low_km, high_km, radar.receiver.range_cell_km))
    p_fa = radar.detector.p_fa
    return gain * threshold(p_fa, n_cell) / threshold(p_fa)
