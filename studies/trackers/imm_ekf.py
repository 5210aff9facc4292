"""An interacting multiple model of extended Kalman filters, with global nearest neighbours, in NumPy.

Symbols: s = [x, vx, y, vy, w], km, km/s, and the turn rate w, rad/s; n tracks, M modes. Each mode is a coordinated turn
with its noise; the first one has w = 0. (Blom and Bar-Shalom 1988; Bar-Shalom et al. 2001, sections 11.6.6, 11.7.2)
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from scipy.optimize import linear_sum_assignment

from cogradar.shared.numerics.constants import G_KM_S2
from studies.trackers.scans import Floats, Followed, Scan

CONFIRMED_AFTER, ENDED_AFTER = 2, 3  # detections, dwells without one
GATE = 5.0  # Mahalanobis distance
V_SIGMA_KM_S = 0.3  # of a new track
SPEED_KM_S = 0.25  # at which a turn rate is so many g
# Chosen for the smallest GOSPA in three skies of `six`: of turns and hard turns. Straight flight has the radar's
# `motion.sigma_straight_km_s2`.
ACCELERATIONS_KM_S2 = (0.01, 0.06)
TURN_RATES = np.array([0.0, 3.0, 8.0]) * G_KM_S2 / SPEED_KM_S  # rad/s, standard deviation when a turn begins
RATE_NOISE = 0.6 * TURN_RATES  # in a second
STAYS = np.array([[0.9, 0.05, 0.05], [0.1, 0.8, 0.1], [0.15, 0.1, 0.75]])  # from mode to mode in a second
AT_FIRST = np.array([0.9, 0.07, 0.03])
M = len(AT_FIRST)


class Belief(NamedTuple):
    """Of n tracks."""

    weights: Floats  # (n, M)
    means: Floats  # (n, M, 5)
    covariances: Floats  # (n, M, 5, 5)

    def of(self, kept: list[int]) -> Self:
        return type(self)(*(values[kept] for values in self))


def merged(weights: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of Gaussian mixtures: (..., M), (..., M, d), (..., M, d, d) -> (..., d), (..., d, d)."""
    mean = np.einsum("...i,...ia->...a", weights, means)
    off = means - mean[..., np.newaxis, :]
    spread = covariances + off[..., :, np.newaxis] * off[..., np.newaxis, :]
    return mean, np.einsum("...i,...iab->...ab", weights, spread)


def turned(s: Floats, dt: float) -> tuple[Floats, Floats]:
    """States after a coordinated turn, and the Jacobian: (..., 5) -> (..., 5), (..., 5, 5)."""
    _, vx, _, vy, w = np.moveaxis(s, -1, 0)
    w = np.where(np.abs(w) < 1e-5, 1e-5, w)
    sin, cos = np.sin(w * dt), np.cos(w * dt)
    ahead, aside = sin / w, (1.0 - cos) / w
    ahead_w, aside_w = (dt * cos - ahead) / w, (dt * sin - aside) / w
    f = np.zeros((*s.shape, 5))
    f[..., 0, 0] = f[..., 2, 2] = f[..., 4, 4] = 1.0
    f[..., 0, 1] = f[..., 2, 3] = ahead
    f[..., 2, 1], f[..., 0, 3] = aside, -aside
    f[..., 1, 1] = f[..., 3, 3] = cos
    f[..., 3, 1], f[..., 1, 3] = sin, -sin
    moved = np.einsum("...ab,...b->...a", f, s)
    f[..., 0, 4], f[..., 1, 4] = ahead_w * vx - aside_w * vy, -dt * moved[..., 3]
    f[..., 2, 4], f[..., 3, 4] = aside_w * vx + ahead_w * vy, dt * moved[..., 1]
    return moved, f


def predicted(belief: Belief, dt: float, sigma_straight: float) -> Belief:
    """The modes mixed, and a dwell later."""
    stays = np.linalg.matrix_power(STAYS, max(round(dt), 1))
    joint = belief.weights[:, :, np.newaxis] * stays  # from i to j
    weights = joint.sum(axis=1)
    means, covariances = belief.means.copy(), belief.covariances.copy()
    for j in range(M):
        own, own_covariance = belief.means.copy(), belief.covariances.copy()
        if j:  # a turn that begins has any rate
            own_covariance[:, 0, 4, 4] = TURN_RATES[j] ** 2
        means[:, j], covariances[:, j] = merged(joint[:, :, j] / weights[:, j, np.newaxis], own, own_covariance)
    means[:, 0, 4], covariances[:, 0, 4, :], covariances[:, 0, :, 4] = 0.0, 0.0, 0.0
    moved, f = turned(means, dt)
    covariances = f @ covariances @ np.swapaxes(f, -1, -2)
    by = np.array([0.5 * dt * dt, dt])
    for j, sigma in enumerate((sigma_straight, *ACCELERATIONS_KM_S2)):
        scale = 1.0 if j == 0 else 1.0 / dt  # maneuvers are independent from second to second
        for axis in (slice(0, 2), slice(2, 4)):
            covariances[:, j, axis, axis] += np.outer(by, by) * sigma**2 * scale
        covariances[:, j, 4, 4] += RATE_NOISE[j] ** 2 * dt
    covariances[:, 0, 4, :], covariances[:, 0, :, 4] = 0.0, 0.0
    return Belief(weights, moved, covariances)


def measured(means: Floats) -> tuple[Floats, Floats]:
    """Direction and range, and the Jacobian: (..., 5) -> (..., 2), (..., 2, 5)."""
    x, y = means[..., 0], means[..., 2]
    r = np.maximum(np.hypot(x, y), 1e-3)
    h = np.zeros((*means.shape[:-1], 2, 5))
    h[..., 0, 0], h[..., 0, 2] = -0.5 * x * y / r**3, 0.5 * x * x / r**3
    h[..., 1, 0], h[..., 1, 2] = x / r, y / r
    return np.stack((0.5 * y / r, r), axis=-1), h


def updated(belief: Belief, z: Floats, noise: Floats) -> Belief:
    """Each track by its detection: z (n, 2), noise (n, 2) variances."""
    expected, h = measured(belief.means)
    ht = np.swapaxes(h, -1, -2)
    s = h @ belief.covariances @ ht + _diagonal(noise)[:, np.newaxis]
    gain = belief.covariances @ ht @ np.linalg.inv(s)
    off = z[:, np.newaxis] - expected
    off[..., 0] -= np.rint(off[..., 0])  # -0.5 and 0.5 are one direction
    means = belief.means + np.einsum("...ab,...b->...a", gain, off)
    covariances = belief.covariances - gain @ s @ np.swapaxes(gain, -1, -2)
    logs = -0.5 * (_distance(off, s) + np.log(np.linalg.det(s)))
    weights = belief.weights * np.exp(logs - logs.max(axis=1, keepdims=True))
    weights = np.maximum(weights / weights.sum(axis=1, keepdims=True), 1e-12)
    return Belief(
        weights / weights.sum(axis=1, keepdims=True), means, 0.5 * (covariances + np.swapaxes(covariances, -1, -2))
    )


def _diagonal(variances: Floats) -> Floats:
    return np.asarray(variances[..., np.newaxis] * np.eye(2))


def _distance(off: Floats, s: Floats) -> Floats:
    """Mahalanobis distances, squared."""
    return np.asarray(np.einsum("...a,...ab,...b->...", off, np.linalg.inv(s), off))


def begun(z: Floats, noise: Floats) -> Belief:
    """New tracks at their detections."""
    n, sine, r = len(z), np.clip(2.0 * z[:, 0], -0.999, 0.999), z[:, 1]
    cosine = np.sqrt(1.0 - sine**2)
    means, covariances = np.zeros((n, M, 5)), np.zeros((n, M, 5, 5))
    means[:, :, 0], means[:, :, 2] = (r * cosine)[:, np.newaxis], (r * sine)[:, np.newaxis]
    jacobian = np.empty((n, 2, 2))  # of x, y by nu, r
    jacobian[:, 0, 0], jacobian[:, 1, 0], jacobian[:, 0, 1], jacobian[:, 1, 1] = (
        -2.0 * r * sine / cosine,
        2.0 * r,
        cosine,
        sine,
    )
    places = jacobian @ _diagonal(noise) @ np.swapaxes(jacobian, -1, -2)
    covariances[:, :, 0:3:2, 0:3:2] = places[:, np.newaxis]
    covariances[:, :, 1, 1] = covariances[:, :, 3, 3] = V_SIGMA_KM_S**2
    covariances[:, :, 4, 4] = TURN_RATES**2
    return Belief(np.tile(AT_FIRST, (n, 1)), means, covariances)


@dataclass
class _Track:
    id: int
    detections: int = 1
    missed: int = 0  # dwells since the last detection


def followed(scans: Iterable[Scan], dt: float, sigma_straight: float) -> Iterator[Followed]:
    """Confirmed tracks after each scan."""
    belief, tracks, last = begun(np.empty((0, 2)), np.empty((0, 2))), list[_Track](), 0
    for scan in scans:
        belief = predicted(belief, dt, sigma_straight)
        z = np.column_stack((scan.nus, scan.ranges_km))
        noise = np.column_stack((scan.nu_sigmas**2, np.full(len(z), scan.range_sigma_km**2)))
        confirmed = np.array([track.detections >= CONFIRMED_AFTER for track in tracks], dtype=np.bool_)
        pairs, free = dict[int, int](), np.ones(len(z), dtype=np.bool_)
        for group in (np.flatnonzero(confirmed), np.flatnonzero(~confirmed)):
            left = np.flatnonzero(free)
            found = {int(group[i]): int(left[j]) for i, j in _assigned(belief.of(group.tolist()), z[left], noise[left])}
            free[list(found.values())] = False
            pairs |= found
        at, to = list(pairs), list(pairs.values())
        if pairs:
            for values, new in zip(belief, updated(belief.of(at), z[to], noise[to]), strict=True):
                values[at] = new
        for i, track in enumerate(tracks):
            track.detections, track.missed = track.detections + (i in pairs), 0 if i in pairs else track.missed + 1
        kept = [i for i, track in enumerate(tracks) if track.missed < ENDED_AFTER]
        tracks = [tracks[i] for i in kept] + [_Track(last + 1 + i) for i in range(int(free.sum()))]
        last += int(free.sum())
        belief = Belief(*map(np.concatenate, zip(belief.of(kept), begun(z[free], noise[free]), strict=True)))
        shown = [i for i, track in enumerate(tracks) if track.detections >= CONFIRMED_AFTER]
        means, covariances = merged(*belief.of(shown))
        yield Followed([tracks[i].id for i in shown], means[:, :4], covariances[:, :4, :4])


def _assigned(belief: Belief, z: Floats, noise: Floats) -> list[tuple[int, int]]:
    """Tracks and detections in each other's gates, as many as there can be and the most likely of these."""
    if not (len(z) and len(belief.weights)):
        return []
    expected, h = measured(belief.means)
    mean, s = merged(belief.weights, expected, h @ belief.covariances @ np.swapaxes(h, -1, -2))
    s = s[:, np.newaxis] + _diagonal(noise)
    distances = _distance(z - mean[:, np.newaxis], s)
    is_near = distances < GATE**2
    costs = np.where(is_near, distances + np.log(np.linalg.det(s)), 0.0)
    costs = np.where(is_near, costs - costs.max() - GATE**2, 0.0)
    rows, columns = linear_sum_assignment(costs)
    return [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if is_near[i, j]]
