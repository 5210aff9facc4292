"""Looks widened where there is power to spare: a track whose target may have turned away is looked for nearby, too.

Symbols: g gain of a look, w beam power; zeta = g w; lambda threshold. A look is sure at zeta = (sqrt lambda + 3)^2,
where P_D is 0.999.

The beams of an objective often have more power than a detection needs: the rest buys accuracy of the range.
What is above twice the sure power is spare. A share of it, the same of every beam, is spent on further cells, each with
the sure power of its track. The nearest and cheapest come first: the farther a cell, the less probable is the target
there. The share is small while nothing is amiss, so that ranges lose nearly nothing, and half for tracks whose misses
the model cannot explain. One dwell in which a target is found is worth more than one of accurate ranges.
"""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.power.rules import Emission, Requests
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import beam_factor

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

NEARLY_SURE = 3.0  # in sqrt zeta, above sqrt lambda: P_D is 0.999
KEPT = 2.0  # a beam keeps this multiple of the sure power, whatever is taken
CALM, ASTRAY = 0.03, 0.5  # shares of what is spare
LEAST_FIXED = 0.5  # of the power of all tracks, for those that ask for a fixed one
_LEAST_GAIN = 1e-12
_APART = 0.75  # of a cell: what is nearer to a lit one is no further cell


def sure_powers(radar: RadarConfig, gains: Floats) -> Floats:
    """Beam power that makes a look nearly sure, of looks with these gains; (M,) -> (M,)."""
    zeta = (np.sqrt(threshold(radar.detector.p_fa)) + NEARLY_SURE) ** 2
    return np.asarray(zeta / np.maximum(gains, _LEAST_GAIN))


def wanted(radar: RadarConfig, requests: Requests) -> Floats:
    """How many times as strong looks at tracks are to be as without priorities, (M,) >= 1.

    As a priority says, but with all the power a look must still be sure: one that asks for more would be thought to be
    in vain. One below 1 makes no look too weak to find a target; it is worth less.
    """
    most = radar.array.power / sure_powers(radar, requests.gains)
    return np.asarray(np.maximum(np.minimum(requests.priorities, most), 1.0))


def affordable(radar: RadarConfig, requests: Requests, power: float) -> Floats:
    """The fixed powers of tracks, (M,), of so much for all of them; each is as asked for, or at the most there is.

    They have what other tracks need not have to be found for sure, at least half of the power.
    """
    fixed = np.broadcast_to(requests.fixed, requests.gains.shape)
    sure = sure_powers(radar, requests.gains) * (requests.chances.sum(axis=1) > 0.0)
    return levelled(fixed, most_fixed(power, float(sure[fixed == 0.0].sum())))


def most_fixed(power: float, needed: float) -> float:
    """Power for tracks that ask for a fixed one, where others need so much to be found for sure."""
    return max(power - needed, LEAST_FIXED * power)


def levelled(asked: Floats, most: float) -> Floats:
    """Powers, (M,), that sum to `most` at most: the greatest are made equal, so that as many as can be are as asked."""
    level, left, n = np.inf, most, asked.size
    for one in np.sort(asked).tolist():
        if one * n > left:
            level = left / n
            break
        left, n = left - one, n - 1
    return np.minimum(asked, level)


def widened(radar: RadarConfig, requests: Requests, sent: Emission) -> Emission:
    """What is sent with further cells for tracks that ask for them; as it is if there is no power for any.

    A track none of whose own cells is sure gets none: its own would need the power more. The powers sum to what they
    did before.
    """
    if not requests.reaches.any():
        return sent
    sure = sure_powers(radar, requests.gains / wanted(radar, requests))
    spare = np.maximum(sent.shares - np.maximum(KEPT * sure, requests.fixed)[:, np.newaxis], 0.0)
    nus, distances = _beside(radar, sent.nus)
    is_near = (distances <= requests.reaches[:, np.newaxis] + _APART) & (sent.shares[:, :1] >= sure[:, np.newaxis])
    costs = np.where(is_near, sure[:, np.newaxis], np.inf)
    astray = requests.astray[:, np.newaxis]
    chosen = _affordable(np.where(astray, costs, np.inf), distances, ASTRAY * spare.sum())
    chosen |= _affordable(np.where(astray, np.inf, costs), distances, CALM * spare.sum())
    if not chosen.any():
        return sent
    wide = np.where(chosen, sure[:, np.newaxis], 0.0)
    shares = np.hstack((sent.shares - spare * (wide.sum() / spare.sum()), wide))
    order = np.argsort(-shares, axis=1, kind="stable")[:, : int((shares > 0.0).sum(axis=1).max())]
    shares = np.take_along_axis(shares, order, axis=1)
    is_lit = shares > 0.0
    lit = np.where(is_lit, np.take_along_axis(np.hstack((sent.nus, nus)), order, axis=1), np.nan)
    factor = beam_factor(lit[is_lit], shares[is_lit], radar.array.n_tx)
    return Emission(sent.isotropic, factor, lit, shares, sent.status)


def _beside(radar: RadarConfig, nus: Floats) -> tuple[Floats, Floats]:
    """All further cells of each track, (M, 2 n_bin - 1), and how many cells they are from the nearest lit one.

    nus : (M, L) directions lit, brightest first; NaN: none (further). Cells are counted from the first; what is none,
          or is lit already, is infinitely far away
    """
    n_bin = radar.array.n_bin
    step = 1.0 / (n_bin - 1)
    beside = nus[:, :1] + step * np.arange(1 - n_bin, n_bin)
    distances = (
        np.abs(beside[:, np.newaxis] - np.where(np.isnan(nus), np.inf, nus)[:, :, np.newaxis]).min(axis=1) / step
    )
    is_cell = (np.abs(beside) < 0.5 + 0.5 * step) & (distances > _APART)
    return np.clip(beside, -0.5, 0.5), np.where(is_cell, distances, np.inf)


def _affordable(costs: Floats, distances: Floats, budget: float) -> Bools:
    """Which cells this power suffices for, the nearest and cheapest first; (M, n) each."""
    is_offered = (costs <= budget) & np.isfinite(distances)
    order = np.argsort(
        np.where(is_offered, costs * np.where(is_offered, distances, 1.0), np.inf), axis=None, kind="stable"
    )
    spent = np.cumsum(np.where(is_offered, costs, np.inf).ravel()[order])
    chosen = np.zeros(costs.size, dtype=np.bool_)
    chosen[order[: int(np.searchsorted(spent, budget, side="right"))]] = True
    return chosen.reshape(costs.shape)
