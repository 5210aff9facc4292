"""The scene and its signal: targets, disturbance, the echo of each cell, and what the receiver makes of it.

A function of the configuration, the seed and what is transmitted: every random number is keyed by target or cell and
dwell.

What is simplified: each cell is a resolution cell with one echo of its own, y = sum_j alpha_j v(nu_j) + c with a fresh
disturbance c per bin, range cell and dwell. With bins a target echoes in its own bin only, from the bin's centre:
nothing leaks into other bins, and nothing is lost by straddling two. With steered cells it echoes from where it is,
nu_j, in every cell in whose main lobe it is, |nu_j - nu_c| < 1/n_rx, and in its own range cell; sidelobes, and the
grating image beyond nu = +-0.5, are not modelled. Of range cells only those with a target in the main lobe are
computed; of the others the largest statistic is drawn from its distribution.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency
from cogradar.shared.signal.looks import Look, Measured, measure, range_cell_centre, reported
from cogradar.shared.signal.monopulse import direction, flat_ratio_sigma, kappa_sq
from cogradar.shared.signal.radar_equation import amplitude, amplitude_at_1_km
from cogradar.shared.signal.receiver import Cell
from cogradar.shared.signal.waveform import Signature, Signatures
from cogradar.shared.world.disturbance import draw, power_spectrum
from cogradar.shared.world.targets import Flights, echo_amplitudes

PREPARED_BYTES = 1 << 20  # of disturbance: what stays in a core's cache until it is used; to fetch more gains nothing
NO_RANGE = -1  # number of the range cell where there are none
_RANGE_KEY = 1 << 16  # between the keys of one bin's range cells, more than there can be bins

Place = tuple[int, int]  # bin and range cell of a disturbance


class _Echo(NamedTuple):
    """What the targets of one direction and range cell send back."""

    nu: float
    range_cell: int
    alpha: complex


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


@lru_cache(maxsize=1024)  # more than the directions of an acquisition, in which each dwell asks for all of them
def _level(disturbance_model: str, nu: float) -> float:
    """S_c(nu)."""
    return float(power_spectrum(disturbance_model, nu))


class Scene:
    """One run's targets and the air between them and the radar."""

    def __init__(self, world: WorldConfig, radar: RadarConfig, seed: int, t: int) -> None:
        """The scene at clock t. The targets fly from t = 1 on, whatever was transmitted."""
        self._flights = Flights(world, radar.motion.dt_s, seed)
        self.states = self._flights.start()  # (M, 4) [x, vx, y, vy], km and km/s; of those that are not there, any
        self.t = 0
        self.drawn: list[Place] = []  # where disturbance was drawn in the last dwell
        self._seed = seed
        self._array, self._receiver = radar.array, radar.receiver
        self._disturbance_model = world.disturbance.model
        echo_db = world.echo.amplitude_db
        self._at_1_km = np.array([amplitude_at_1_km(echo_db + target.rcs_db) for target in world.targets])
        self._laws = [target.rcs or world.rcs for target in world.targets]
        self._is_on_grid = radar.receiver.cells == "bins"
        # How far off its direction a cell hears an echo; on the grid the next one is a whole bin away.
        self._reach = 0.5 / (radar.array.n_bin - 1) if self._is_on_grid else 1.0 / radar.array.n_rx
        self._moved: NDArray[np.float64] | None = None  # states at t+1
        self._prepared: dict[tuple[Place, int], NDArray[np.complex128]] = {}  # disturbance by place and dwell
        while self.t < t:
            self.move()

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which targets are there, (M,)."""
        return self._flights.present(self.states, self.t)

    @property
    def target_bins(self) -> NDArray[np.int64]:
        """Angle bin of each target, (M,); also of one that is not there."""
        return angle_bin(spatial_frequency(self.states), self._array.n_bin)

    @property
    def range_km(self) -> NDArray[np.float64]:
        """Range of each target, (M,)."""
        return np.asarray(np.hypot(self.states[:, 0], self.states[:, 2]))

    @property
    def snr_db(self) -> NDArray[np.float64]:
        """Signal-to-noise ratio of each target per virtual channel, before array gain, (M,); that of its mean RCS."""
        return np.asarray(20.0 * np.log10(amplitude(self._at_1_km, self.range_km**2)))

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

    def observe(
        self, k: int, isotropic: float, factor: NDArray[np.complex128], looks: Sequence[Look]
    ) -> list[Measured]:
        """What the receiver reports of these looks in dwell k, with R = (isotropic / n_tx) I + F F^H transmitted.

        factor : (n_tx, r) complex, F
        looks  : by direction
        """
        echoes, self.drawn = self._echoes(k), []
        signatures = Signatures(isotropic, factor, self._array.n_rx)
        signatures.prepare(np.array([look.nu for look in looks]))
        measured = [one for look in looks for one in self._measured(k, look, echoes, signatures)]
        self._prepared = {}
        return reported(measured)

    def _measured(self, k: int, look: Look, echoes: Sequence[_Echo], signatures: Signatures) -> list[Measured]:
        """The cells of a look: those with a target, and the loudest of the others."""
        heard = [echo for echo in echoes if abs(echo.nu - look.nu) < self._reach]
        occupied = sorted({echo.range_cell for echo in heard if echo.range_cell in look.cells})
        receiver, measured = self._receiver, []
        for cell in occupied if look.cells else [NO_RANGE]:
            y = self._met((look.bin, cell), k)
            for echo in heard:
                if echo.range_cell == cell:
                    add_echo(y, echo.alpha, *signatures.at(echo.nu))
            range_km = range_cell_centre(cell, receiver.range_cell_km) if look.cells else 0.0
            measured.append(
                measure(look, y, range_km, signatures, is_steered=not self._is_on_grid, monopulse=receiver.monopulse)
            )
        if len(look.cells) > len(occupied):
            measured.append(self._loudest_empty(k, look, occupied, signatures.at(look.nu)))
        return measured

    def _next_states(self) -> NDArray[np.float64]:
        return self._flights.moved(self.states, self.t + 1)

    def _met(self, place: Place, k: int) -> NDArray[np.complex128]:
        """Disturbance as a cell meets it; to be changed by whoever asked."""
        self.drawn.append(place)
        prepared = self._prepared.pop((place, k), None)
        return self._disturbance(place, k) if prepared is None else prepared

    def _disturbance(self, place: Place, k: int) -> NDArray[np.complex128]:
        """Disturbance of one cell, (n_tx n_rx,) complex."""
        bin_, range_cell = place
        rng = generator(self._seed, Purpose.DISTURBANCE, bin_ + (range_cell - NO_RANGE) * _RANGE_KEY, k)
        return draw(self._disturbance_model, self._array.n_tx * self._array.n_rx, rng)

    def _echoes(self, k: int) -> list[_Echo]:
        """Echoes of the targets that are there; those of one direction and range cell add up."""
        nus, width = spatial_frequency(self.states), self._receiver.range_cell_km
        if self._is_on_grid:
            nus = bin_centres(self._array.n_bin)[angle_bin(nus, self._array.n_bin)]
        cells = np.floor(self.range_km / width).astype(np.int64) if width > 0.0 else np.full(nus.size, NO_RANGE)
        alphas = echo_amplitudes(self.states, self._at_1_km, self._laws, self._seed, k)
        echoes: dict[tuple[float, int], complex] = {}
        for m in np.flatnonzero(self.present).tolist():
            where = float(nus[m]), int(cells[m])
            echoes[where] = echoes.get(where, 0j) + complex(alphas[m])
        return [_Echo(*where, alpha) for where, alpha in echoes.items()]

    def _loudest_empty(self, k: int, look: Look, occupied: Sequence[int], signature: Signature) -> Measured:
        """The largest statistic of the n range cells of a look that have no target, drawn from its distribution.

            Lambda = -2 ln(1 - U^(1/n)),   U uniform: the largest of n that are chi-square with 2 degrees of freedom

        as each is as the number of channels grows. Which cell, the phase and the measured direction are independent of
        it: noise in the derivative's channel is kappa^2 times that in the sum's, and independent. sigma_hat is what it
        is on average, sqrt(S_c(nu) / ||v||^2).

        occupied : numbers of the other cells, ascending
        """
        u, a_rx = signature
        signature_power = float(np.vdot(u, u).real) * a_rx.size
        if signature_power == 0.0:
            return Measured(look, Cell(0.0, 0j, 0.0, 0.0), 0.0, look.nu, 0.0)
        n = len(look.cells) - len(occupied)
        rng = generator(self._seed, Purpose.EMPTY, int(np.float64(look.nu).view(np.int64)), k)
        statistic = -2.0 * math.log(-math.expm1(-rng.standard_exponential() / n))
        range_cell = look.cells[0] + int(rng.integers(n))
        for other in occupied:
            range_cell += 1 if other <= range_cell else 0
        sigma_hat = math.sqrt(_level(self._disturbance_model, look.nu) / signature_power)
        r = math.sqrt(0.5 * statistic)
        alpha_hat = r * sigma_hat * np.exp(2j * np.pi * rng.random())
        cell = Cell(statistic, complex(alpha_hat), sigma_hat, signature_power)
        range_km = range_cell_centre(range_cell, self._receiver.range_cell_km)
        if not self._receiver.monopulse or statistic < look.limit:
            return Measured(look, cell, range_km, look.nu, 0.0)
        rho = math.sqrt(0.5 * kappa_sq(a_rx.size)) / r * rng.standard_normal()
        rho_sigma = flat_ratio_sigma(rho, r, a_rx.size)
        return Measured(look, cell, range_km, *direction(look.nu, rho, rho_sigma, a_rx.size))
