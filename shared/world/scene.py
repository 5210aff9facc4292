"""The scene and its signal: targets, disturbance, the echo of each cell, and what the receiver makes of it.

A function of the configuration, the seed and what is transmitted: every random number is keyed by target or cell and
dwell.

What is simplified: each angle bin is a resolution cell with one independent echo of its own, y = alpha v + c with a
fresh disturbance c per cell and dwell. A target echoes in its own bin only, from the bin's centre: nothing leaks into
other bins through sidelobes, and nothing is lost by straddling two bins. Targets in one bin add up.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import kernel
from shared.numerics.seeds import Purpose, generator
from shared.scenario.radar_config import RadarConfig
from shared.scenario.world_config import WorldConfig
from shared.signal.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from shared.signal.radar_equation import amplitude_at_1_km, snr_db
from shared.signal.receiver import Cell, wald_test
from shared.signal.waveform import transmit_signatures
from shared.tracking.motion import Motion
from shared.world.disturbance import draw
from shared.world.targets import echo_amplitudes, moved

PREPARED_BYTES = 1 << 20  # of disturbance: what stays in a core's cache until it is used; to fetch more gains nothing


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


class Scene:
    """One run's targets and the air between them and the radar."""

    def __init__(self, world: WorldConfig, radar: RadarConfig, seed: int, t: int) -> None:
        """The scene at clock t. The targets fly from t = 1 on, whatever was transmitted."""
        self.states = world.initial_states()  # (M, 4) [x, vx, y, vy], km and km/s
        self.t = 0
        self._seed = seed
        self._array = radar.array
        self._targets = world.targets
        self._motion = Motion(radar.motion.dt_s, world.motion.sigma_s_km_s2)
        self._disturbance_model = world.disturbance.model
        self._amplitude_db, self._rcs = world.echo.amplitude_db, world.rcs
        self._moved: NDArray[np.float64] | None = None  # states at t+1
        self._drawn: dict[tuple[int, int], NDArray[np.complex128]] = {}  # disturbance by (bin, dwell)
        while self.t < t:
            self.move()

    @property
    def target_bins(self) -> NDArray[np.int64]:
        """Angle bin of each target, (M,)."""
        return angle_bin(spatial_frequency(self.states), self._array.n_bin)

    @property
    def range_km(self) -> NDArray[np.float64]:
        """Range of each target, (M,)."""
        return np.asarray(np.hypot(self.states[:, 0], self.states[:, 2]))

    @property
    def snr_db(self) -> NDArray[np.float64]:
        """Signal-to-noise ratio of each target per virtual channel, before array gain, (M,); that of its mean RCS."""
        return snr_db(self.range_km, self._amplitude_db)

    def move(self) -> None:
        """Let the targets fly for one dwell."""
        prepared, self._moved = self._moved, None
        self.states = self._next_states() if prepared is None else prepared
        self.t += 1

    def prepare(self, k: int, bins: Sequence[int]) -> None:
        """Do what dwell k = the next one needs before it is known what is transmitted.

        bins : cells that will probably be looked at; the first ones are drawn. Results do not depend on the guess.
        """
        self._moved = self._next_states()
        most = PREPARED_BYTES // (np.dtype(np.complex128).itemsize * self._array.n_tx * self._array.n_rx)
        self._drawn = {(bin_, k): self._disturbance(bin_, k) for bin_ in bins[:most]}

    def observe(
        self, k: int, isotropic: float, factor: NDArray[np.complex128], bins: NDArray[np.integer]
    ) -> list[Cell]:
        """What the receiver says of these cells in dwell k, with R = (isotropic / n_tx) I + F F^H transmitted.

        factor : (n_tx, r) complex, F
        """
        nus = bin_centres(self._array.n_bin)[bins]
        echoes = self._echoes(k)
        drawn, self._drawn = self._drawn, {}
        cells = []
        signatures = transmit_signatures(isotropic, factor, nus), steering_vector(nus, self._array.n_rx)
        for bin_, u, a_rx in zip(bins.tolist(), *signatures, strict=True):
            y = drawn[bin_, k] if (bin_, k) in drawn else self._disturbance(bin_, k)
            if bin_ in echoes:
                add_echo(y, echoes[bin_], u, a_rx)
            cells.append(wald_test(y, u, a_rx))
        return cells

    def _next_states(self) -> NDArray[np.float64]:
        return moved(self.states, self._motion, self._seed, self.t + 1, self._targets)

    def _disturbance(self, bin_: int, k: int) -> NDArray[np.complex128]:
        """Disturbance of one cell, (n_tx n_rx,) complex."""
        rng = generator(self._seed, Purpose.DISTURBANCE, bin_, k)
        return draw(self._disturbance_model, self._array.n_tx * self._array.n_rx, rng)

    def _echoes(self, k: int) -> dict[int, complex]:
        """Echo amplitude alpha of each occupied bin."""
        echoes: dict[int, complex] = {}
        alphas = echo_amplitudes(self.states, amplitude_at_1_km(self._amplitude_db), self._rcs, self._seed, k)
        for bin_, alpha in zip(self.target_bins.tolist(), alphas.tolist(), strict=True):
            echoes[bin_] = echoes.get(bin_, 0j) + alpha
        return echoes
