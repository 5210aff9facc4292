"""What a look hears of a target, by how far off its axis the target is.

A bin hears all of its width alike and nothing beyond: its response is a box. A steered look hears with its main lobe,
D_T D_R, and is lost nowhere at once. What follows from that is asked here: which detections may be one echo, where a
target is that was found, which looks a track remembers.

Symbols: d = nu - nu_c direction off the axis of a look; D_T D_R two-way loss of an echo there,
D(d) = |sin(pi N d) / (N sin(pi d))|.
"""

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import arcsin, hypot, ndtr, ndtri
from cogradar.shared.signal.array import KEPT_LOOKS, LOOKS_ROW, angle_bin, apart, bin_centres
from cogradar.shared.signal.looks import NEIGHBOURS
from cogradar.shared.signal.monopulse import off_axis_loss as one_way_loss

Floats = NDArray[np.float64]

FAR_KM = 1e9  # beyond any target: the end of a gate that is open
_LOSS_NODES = 512  # of D_T D_R from the axis to the first null; linear interpolation errs by 5e-6
_LEAST_LOSS = 0.05  # of an amplitude off axis; a target still further off is not detected there


@cache
def grid(n_bin: int) -> Floats:
    """Centres of the bins, made once and only to be read."""
    return bin_centres(n_bin)


def bin_edges(bin_: int, n_bin: int) -> Floats:
    """Directions of the edges of a bin, (2,), within the field of view."""
    # A hair inside the bin, for rounding; bins 0 and n_bin-1 reach beyond end-fire, where there is nothing.
    half = 0.5 / (n_bin - 1) * (1.0 - 1e-9)
    return np.asarray(np.clip(bin_centres(n_bin)[bin_] + np.array([-half, half]), -0.5, 0.5))


def draw_positions(bin_: int, n_bin: int, range_km: Floats, rng: np.random.Generator) -> Floats:
    """Positions at these ranges, (n,) -> (n, 2), their bearings uniform in angle within a bin: none is preferred."""
    low, high = arcsin(2.0 * bin_edges(bin_, n_bin))
    theta = rng.uniform(low, high, range_km.size)
    return np.asarray(range_km[:, None] * np.column_stack((np.cos(theta), np.sin(theta))))


def placed(particles: Floats, range_km: Floats, nu: Floats) -> Floats:
    """Particles, (n, 4), at these ranges and directions, with the velocities that they have."""
    moved = particles.copy()
    moved[:, 0], moved[:, 2] = range_km * np.sqrt(1.0 - 4.0 * nu**2), range_km * 2.0 * nu
    return moved


@dataclass(frozen=True)
class BinResponse:
    """A box: a look hears its bin of the grid."""

    n_bin: int
    is_box = True
    range_cell_km = np.inf
    measures_range = False

    @property
    def lobe(self) -> float:
        """From the axis of a look to where it hears nothing any more, in nu."""
        return 0.5 / (self.n_bin - 1)

    @property
    def memory_width(self) -> int:
        """Numbers by which a track remembers the looks of a dwell."""
        return self.n_bin

    def loss(self, d: ArrayLike) -> Floats:
        """D_T D_R of echoes off the axis of a look by d in nu, 0 where it hears nothing; (...) -> (...)."""
        return np.where(np.abs(d) < self.lobe, 1.0, 0.0)

    def echo_from(self, nus: Floats) -> Floats:
        """Directions that echoes of targets at these directions come from, (n,): the centres of their bins."""
        return np.asarray(grid(self.n_bin)[angle_bin(nus, self.n_bin)])

    def loss_table(self) -> Floats:
        """D_T D_R at equal steps from the axis to `lobe`, (n,)."""
        return np.ones(2)

    def is_one_echo(
        self, nus: Floats, _ranges_km: Floats, other: tuple[float | Floats, float | Floats]
    ) -> NDArray[np.bool_]:
        """Whether detections in these directions and range cells, (n,), may be of the target of others, (nu, R).

        Bins at both ends are one direction.
        """
        return np.asarray(apart(nus, other[0]) == 0.0)

    def shares(self, nus: Floats, at: Floats, is_tested: NDArray[np.bool_]) -> Floats:
        """Share of the particles that looks in these directions would most probably find, (c,).

        at        : (n,) directions of the particles
        is_tested : (n,) whether their ranges are
        """
        count = np.bincount(angle_bin(at[is_tested], self.n_bin), minlength=self.n_bin)
        return np.asarray(count[angle_bin(nus, self.n_bin)] / at.size)

    def bin_for_ranges(self, nu: float) -> int:
        """Bin in which `redrawn` particles begin, for a detection in this direction."""
        return int(angle_bin(nu, self.n_bin))

    def aimed(
        self, particles: Floats, _nu_c: float, _measured: tuple[float, float], _range_km: float, _: np.random.Generator
    ) -> Floats:
        """Particles whose ranges explain a detection on axis, (n, 4), put where it was measured.

        nu_c     : direction of the look
        measured : direction of the echo and its standard deviation; 0: unknown
        range_km : centre of the range cell; 0: none
        """
        return particles

    def turned(
        self, particles: Floats, nu_c: float, _measured: tuple[float, float], rng: np.random.Generator
    ) -> Floats:
        """Particles, (n, 4), in the direction of a detection, with the ranges and velocities that they have."""
        moved, ranges_km = particles.copy(), hypot(particles[:, 0], particles[:, 2])
        moved[:, 0::2] = draw_positions(self.bin_for_ranges(nu_c), self.n_bin, ranges_km, rng)
        return moved

    def row_of(self, nus: Floats, sigma: Floats, _limits: tuple[float, float, float], _nu: float) -> Floats:
        """Looks without a detection as numbers to be remembered, (`memory_width`,).

        limits : of the test, and the gate
        nu     : where the target was expected
        """
        row = np.zeros(self.n_bin)
        row[angle_bin(nus, self.n_bin)] = sigma
        return row

    def looks_of(self, row: Floats, limit: float) -> tuple[Floats, Floats, tuple[float, float, float]]:
        """Directions, standard deviations and limits that `row_of` remembered; limit: of the test."""
        bins = np.flatnonzero(row)
        return bin_centres(self.n_bin)[bins], row[bins], (limit, 0.0, FAR_KM)


@dataclass(frozen=True)
class LobeResponse:
    """The main lobe of a steered look. Each method is described at `BinResponse`."""

    n_bin: int
    n_tx: int
    n_rx: int
    range_cell_km: float  # infinite: ranges are not measured, one cell has all of them
    is_box = False
    memory_width = LOOKS_ROW

    @property
    def measures_range(self) -> bool:
        return self.range_cell_km < np.inf

    @property
    def lobe(self) -> float:
        """From the axis to the first null, in nu. Nothing is received beyond."""
        return 1.0 / self.n_rx

    def loss(self, d: ArrayLike) -> Floats:
        d = apart(d, 0.0)
        lost, is_heard = np.zeros(d.shape), d < self.lobe
        received = one_way_loss(d[is_heard], self.n_rx)
        lost[is_heard] = received * (received if self.n_tx == self.n_rx else one_way_loss(d[is_heard], self.n_tx))
        return lost

    def echo_from(self, nus: Floats) -> Floats:
        return nus

    def loss_table(self) -> Floats:
        return _loss_table(self)

    def is_one_echo(
        self, nus: Floats, ranges_km: Floats, other: tuple[float | Floats, float | Floats]
    ) -> NDArray[np.bool_]:
        near = apart(nus, other[0]) < NEIGHBOURS * self.lobe
        return np.asarray(near & (np.abs(ranges_km - other[1]) < NEIGHBOURS * self.range_cell_km))

    def shares(self, nus: Floats, at: Floats, is_tested: NDArray[np.bool_]) -> Floats:
        return np.asarray((is_tested & (apart(at, nus[:, np.newaxis]) < 0.5 * self.lobe)).mean(axis=1))

    def bin_for_ranges(self, nu: float) -> int:  # noqa: ARG002
        return self.n_bin // 2  # any: directions are drawn apart from ranges

    def aimed(
        self, particles: Floats, nu_c: float, measured: tuple[float, float], range_km: float, rng: np.random.Generator
    ) -> Floats:
        nu = self._directions(nu_c, measured, particles.shape[0], rng)
        if range_km > 0.0:
            half = 0.5 * self.range_cell_km
            return placed(particles, np.maximum(rng.uniform(range_km - half, range_km + half, nu.size), 0.0), nu)
        # R_0 explains the amplitude on axis, so that R_0 sqrt(D_T D_R(nu - nu_c)) explains it in direction nu.
        loss = np.maximum(self.loss(nu - nu_c), _LEAST_LOSS)
        return placed(particles, hypot(particles[:, 0], particles[:, 2]) * np.sqrt(loss), nu)

    def turned(self, particles: Floats, nu_c: float, measured: tuple[float, float], rng: np.random.Generator) -> Floats:
        nu = self._directions(nu_c, measured, particles.shape[0], rng)
        return placed(particles, hypot(particles[:, 0], particles[:, 2]), nu)

    def row_of(self, nus: Floats, sigma: Floats, limits: tuple[float, float, float], nu: float) -> Floats:
        row, nearest = np.zeros(LOOKS_ROW), np.argsort(apart(nus, nu), kind="stable")[:KEPT_LOOKS]
        row[:3] = limits
        row[3 : 3 + nearest.size] = nus[nearest]
        row[3 + KEPT_LOOKS : 3 + KEPT_LOOKS + nearest.size] = sigma[nearest]
        return row

    def looks_of(self, row: Floats, limit: float) -> tuple[Floats, Floats, tuple[float, float, float]]:  # noqa: ARG002
        sigma = row[3 + KEPT_LOOKS :]
        is_look = sigma > 0.0
        low, high, far = row[:3].tolist()
        return row[3 : 3 + KEPT_LOOKS][is_look], sigma[is_look], (low, high, far)

    def _directions(self, nu_c: float, measured: tuple[float, float], n: int, rng: np.random.Generator) -> Floats:
        """Directions (n,) in front of the array: N(nu_hat, nu_sigma^2); within half of the main lobe if sigma is 0."""
        nu_hat, nu_sigma = measured
        if nu_sigma == 0.0:
            low, high = np.clip(nu_c + 0.5 * self.lobe * np.array([-1.0, 1.0]), -0.5, 0.5)
            return rng.uniform(low, high, n)
        low, high = ndtr((np.array([-0.5, 0.5]) - nu_hat) / nu_sigma)
        return np.clip(nu_hat + nu_sigma * ndtri(rng.uniform(low, high, n)), -0.5, 0.5)


Response = BinResponse | LobeResponse


def strongest_of_each(response: Response, statistic: Floats, nus: Floats, ranges_km: Floats) -> NDArray[np.int64]:
    """Which of n detections are the strongest of their echoes, the strongest first.

    A target between two steered looks is over the limit in both. What is heard at both ends is kept at both: which of
    them it is one scan does not tell.
    """
    found = list[int]()
    for i in np.argsort(-statistic, kind="stable").tolist():
        near = response.is_one_echo(nus[found], ranges_km[found], (float(nus[i]), float(ranges_km[i])))
        if not (near & (np.abs(nus[found] - nus[i]) < 0.5)).any():
            found.append(i)
    return np.array(found, dtype=np.int64)


def response_of(cells: str, n_bin: int, n_tx: int, n_rx: int, range_cell_km: float) -> Response:
    """Of the looks of a radar, by `radar.receiver.cells`; a range cell of width 0 stands for none."""
    return LobeResponse(n_bin, n_tx, n_rx, range_cell_km or np.inf) if cells == "steered" else BinResponse(n_bin)


@lru_cache(maxsize=16)
def _loss_table(response: LobeResponse) -> Floats:
    d = np.linspace(0.0, response.lobe, _LOSS_NODES + 1)
    return np.append(response.loss(d[:-1]), 0.0)
