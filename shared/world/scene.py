"""The scene and its signal: targets, disturbance, the echo of each cell, and what the receiver makes of it.

A function of the configuration, the seed and what is transmitted: every random number is keyed by target or cell and
dwell.

Two signals of it can be computed, by `world.signal`: independent cells (`cell_scene`), and an array, in
which every look is tested with one data set (`array_scene`).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import hypot, log10
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.signal.array import angle_bin, in_plane, spatial_frequency
from cogradar.shared.signal.detector.data_set import Processing
from cogradar.shared.signal.looks import NO_RANGE, Look, Measured, range_cell_centre
from cogradar.shared.signal.monopulse import direction, flat_ratio_sigma, kappa_sq
from cogradar.shared.signal.radar_equation import amplitude, amplitude_at_1_km
from cogradar.shared.signal.receiver import Cell
from cogradar.shared.world.disturbance import draw, levels
from cogradar.shared.world.targets import Flights, echo_amplitudes

PREPARED_BYTES = 1 << 20  # of disturbance: what stays in a core's cache until it is used; to fetch more gains nothing
KEPT_LEVELS = 1024  # more than the directions of an acquisition, in which each dwell asks for all of them
_RANGE_KEY = 1 << 16  # between the keys of one bin's range cells, more than there can be bins

Place = tuple[int, int]  # bin and range cell of a disturbance


@kernel
def add_echo(
    y: NDArray[np.complex128], alpha: complex, u: NDArray[np.complex128], a_rx: NDArray[np.complex128]
) -> None:
    """Add the echo of a target to what a cell receives, y += alpha v with v = u kron a_R; (n_tx n_rx,) in place."""
    for i in range(u.size):
        _add_scaled(y[i * a_rx.size : (i + 1) * a_rx.size], alpha * u[i], a_rx)


@kernel
def _add_scaled(y: NDArray[np.complex128], factor: complex, a_rx: NDArray[np.complex128]) -> None:
    """y += factor a_R of one transmit channel; a function of its own, so that the compiler vectorises the loop."""
    for r in range(a_rx.size):
        y[r] += factor * a_rx[r]


class Scene(ABC):
    """One run's targets and the air between them and the radar."""

    def __init__(self, world: WorldConfig, radar: RadarConfig, seed: int, t: int) -> None:
        """The scene at clock t. The targets fly from t = 1 on, whatever was transmitted."""
        self._flights = Flights(world, radar.motion.dt_s, seed)
        self.states = self._flights.start()  # (M, 4) [x, vx, y, vy], km and km/s; of those that are not there, any
        self.t = self._flights.begun(t)
        self.drawn: list[Place] = []  # where disturbance was drawn in the last dwell
        self._seed = seed
        self._array, self._receiver, self._processing = radar.array, radar.receiver, Processing.of(radar.receiver)
        self._disturbance_model = world.disturbance.model
        echo_db = world.echo.amplitude_db
        self._at_1_km = np.array([amplitude_at_1_km(echo_db + target.rcs_db) for target in world.targets])
        self._laws = [target.rcs or world.rcs for target in world.targets]
        self._is_on_grid = radar.receiver.cells == "bins"
        self._levels: dict[float, float] = {}  # S_c by direction
        self._moved: NDArray[np.float64] | None = None  # states at t+1
        self._prepared: dict[tuple[Place, int], NDArray[np.complex128]] = {}  # disturbance by place and dwell
        while self.t < t:
            self.move()

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which targets are there, (M,)."""
        return self._flights.present(self.states, self.t)

    @property
    def heights_km(self) -> NDArray[np.float64]:
        """Height of each target, (M,)."""
        return self._flights.heights(self.t)

    @property
    def measured_states(self) -> NDArray[np.float64]:
        """States where the array measures the targets, (M, 4): with the range and direction of their height."""
        return in_plane(self.states, self.heights_km)

    @property
    def target_bins(self) -> NDArray[np.int64]:
        """Angle bin of each target, (M,); also of one that is not there."""
        return angle_bin(spatial_frequency(self.measured_states), self._array.n_bin)

    @property
    def range_km(self) -> NDArray[np.float64]:
        """Range of each target, (M,)."""
        return np.asarray(hypot(self.measured_states[:, 0], self.states[:, 2]))

    @property
    def snr_db(self) -> NDArray[np.float64]:
        """Signal-to-noise ratio of each target per virtual channel, before array gain, (M,); for its mean RCS."""
        return np.asarray(20.0 * log10(amplitude(self._at_1_km, self.range_km**2)))

    def move(self) -> None:
        """Let the targets fly for one dwell."""
        prepared, self._moved = self._moved, None
        self.states = self._next_states() if prepared is None else prepared
        self.t += 1

    def prepare(self, k: int, places: Sequence[Place]) -> None:
        """Do what dwell k = the next one needs before it is known what is transmitted.

        places : where disturbance will probably be met; the first ones are drawn. Results do not depend on the guess.
        """
        self._moved = self._next_states()
        most = PREPARED_BYTES // (np.dtype(np.complex128).itemsize * self._array.n_tx * self._array.n_rx)
        self._prepared = {(place, k): self._disturbance(place, k) for place in places[:most]}

    @abstractmethod
    def observe(
        self, k: int, isotropic: float, factor: NDArray[np.complex128], looks: Sequence[Look]
    ) -> list[Measured]:
        """What the receiver reports of these looks in dwell k, with R = (isotropic / n_tx) I + F F^H transmitted.

        factor : (n_tx, r) complex, F
        looks  : by direction
        """

    def _amplitudes(self, k: int) -> NDArray[np.complex128]:
        """Echo amplitude alpha of each target in dwell k, (M,); 0 of one that is not there."""
        there, alphas = np.flatnonzero(self.present), np.zeros(len(self._laws), dtype=np.complex128)
        laws, numbers = [self._laws[m] for m in there.tolist()], there.tolist()
        states = self.measured_states[there]
        alphas[there] = echo_amplitudes(states, self._at_1_km[there], laws, self._seed, k, numbers)
        return alphas

    def _next_states(self) -> NDArray[np.float64]:
        return self._flights.moved(self.states, self.t + 1)

    def _met(self, place: Place, k: int) -> NDArray[np.complex128]:
        """Disturbance as a cell meets it; to be changed by the caller."""
        self.drawn.append(place)
        prepared = self._prepared.pop((place, k), None)
        return self._disturbance(place, k) if prepared is None else prepared

    def _disturbance(self, place: Place, k: int) -> NDArray[np.complex128]:
        """Disturbance of one cell, (n_tx n_rx,) complex."""
        bin_, range_cell = place
        rng = generator(self._seed, Purpose.DISTURBANCE, bin_ + (range_cell - NO_RANGE) * _RANGE_KEY, k)
        return draw(self._disturbance_model, self._array.n_tx * self._array.n_rx, rng)

    def _work_out_levels(self, looks: Sequence[Look]) -> None:
        """S_c in the directions of looks that `_loudest_empty` may be asked for: together, that is ten times faster."""
        if len(self._levels) > KEPT_LEVELS:
            self._levels = {}
        new = [look.nu for look in looks if look.cells and look.nu not in self._levels]
        if new:
            self._levels |= zip(new, levels(self._disturbance_model, new), strict=True)

    def _loudest_empty(self, k: int, look: Look, occupied: Sequence[int], signature_power: float) -> Measured:
        """The largest statistic of the n range cells of a look that have no target, drawn from its distribution.

            Lambda = -2 ln(1 - U^(1/n)),   U uniform: the largest of n that are chi-square with 2 degrees of freedom

        as each is as the number of channels grows. Which cell, the phase and the measured direction are independent of
        it. Noise in the derivative's channel is kappa^2 times the noise in the sum's, and independent. The mean is
        taken for sigma_hat, sqrt(S_c(nu) / ||v||^2).

        occupied        : numbers of the other cells, ascending
        signature_power : ||v||^2
        """
        if signature_power == 0.0:
            return Measured(look, Cell(0.0, 0j, 0.0, 0.0), 0.0, look.nu, 0.0)
        n = len(look.cells) - len(occupied)
        rng = generator(self._seed, Purpose.EMPTY, int(np.float64(look.nu).view(np.int64)), k)
        statistic = -2.0 * math.log(-math.expm1(-rng.standard_exponential() / n))
        range_cell = look.cells[0] + int(rng.integers(n))
        for other in occupied:
            range_cell += 1 if other <= range_cell else 0
        sigma_hat = math.sqrt(self._levels[look.nu] / signature_power)
        r = math.sqrt(0.5 * statistic)
        alpha_hat = r * sigma_hat * np.exp(2j * np.pi * rng.random())
        cell = Cell(statistic, complex(alpha_hat), sigma_hat, signature_power)
        range_km = range_cell_centre(range_cell, self._receiver.range_cell_km)
        if not self._receiver.monopulse or statistic < look.limit:
            return Measured(look, cell, range_km, look.nu, 0.0)
        rho = math.sqrt(0.5 * kappa_sq(self._array.n_rx)) / r * rng.standard_normal()
        rho_sigma = flat_ratio_sigma(rho, r, self._array.n_rx)
        return Measured(look, cell, range_km, *direction(look.nu, rho, rho_sigma, self._array.n_rx))
