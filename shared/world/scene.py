"""The scene and its signal: targets that fly, the disturbance, echoes, and what the receiver makes of them.

A function of the configuration, the seed and what is transmitted: every random number is keyed by target or cell and
dwell.
"""

import cmath
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shared.numerics.seeds import Purpose, generator
from shared.scenario.radar_config import RadarConfig
from shared.scenario.world_config import WorldConfig
from shared.signal.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from shared.signal.radar_equation import amplitude, amplitude_at_1_km, snr_db
from shared.signal.receiver import Cell, wald_test
from shared.signal.waveform import transmit_signatures
from shared.tracking.motion import Motion, propagate_into
from shared.world.disturbance import draw

PREPARED_BYTES = 1 << 20  # of disturbance: what stays in a core's cache until it is used; to fetch more gains nothing


class Scene:
    """One run's targets and the air between them and the radar."""

    def __init__(self, world: WorldConfig, radar: RadarConfig, seed: int, t: int) -> None:
        """The scene at clock t. The targets fly from t = 1 on, whatever was transmitted."""
        self.states = world.initial_states()  # (M, 4) [x, vx, y, vy], km and km/s
        self.t = 0
        self._world = world
        self._radar = radar
        self._seed = seed
        self._moved: NDArray[np.float64] | None = None  # states at t+1
        self._drawn: dict[tuple[int, int], NDArray[np.complex128]] = {}  # disturbance by (bin, dwell)
        while self.t < t:
            self.move()

    @property
    def target_bins(self) -> NDArray[np.int64]:
        """Angle bin of each target, (M,)."""
        return angle_bin(spatial_frequency(self.states), self._radar.array.n_bin)

    @property
    def range_km(self) -> NDArray[np.float64]:
        """Range of each target, (M,)."""
        return np.asarray(np.hypot(self.states[:, 0], self.states[:, 2]))

    @property
    def snr_db(self) -> NDArray[np.float64]:
        """Signal-to-noise ratio of each target per virtual channel, before array gain, (M,)."""
        return snr_db(self.range_km, self._world.echo.amplitude_db)

    def move(self) -> None:
        """Let the targets fly for one dwell."""
        moved, self._moved = self._moved, None
        self.states = self._fly() if moved is None else moved
        self.t += 1

    def prepare(self, k: int, bins: Sequence[int]) -> None:
        """Do what dwell k = the next one needs before it is known what is transmitted.

        bins : cells that will probably be looked at; the first ones are drawn. Results do not depend on the guess.
        """
        self._moved = self._fly()
        array = self._radar.array
        most = PREPARED_BYTES // (np.dtype(np.complex128).itemsize * array.n_tx * array.n_rx)
        self._drawn = {(bin_, k): self._disturbance(bin_, k) for bin_ in bins[:most]}

    def observe(
        self, k: int, isotropic: float, factor: NDArray[np.complex128], bins: NDArray[np.integer]
    ) -> list[Cell]:
        """What the receiver says of these cells in dwell k, with R = (isotropic / n_tx) I + F F^H transmitted.

        factor : (n_tx, r) complex, F
        """
        array = self._radar.array
        nus = bin_centres(array.n_bin)[bins]
        echoes = self._echoes(k)
        drawn, self._drawn = self._drawn, {}
        cells = []
        for bin_, nu, signature in zip(bins.tolist(), nus, transmit_signatures(isotropic, factor, nus), strict=True):
            disturbance = drawn[bin_, k] if (bin_, k) in drawn else self._disturbance(bin_, k)
            cells.append(wald_test(disturbance, signature, steering_vector(nu, array.n_rx), echoes.get(bin_, 0j)))
        return cells

    def _fly(self) -> NDArray[np.float64]:
        """States one dwell later; the noise is keyed by (target, t), so strategies share trajectories."""
        moved = np.empty_like(self.states)
        motion = Motion(self._radar.motion.dt_s, self._world.motion.sigma_s_km_s2)
        for m in range(self.states.shape[0]):
            rng = generator(self._seed, Purpose.MOTION, m, self.t + 1)
            propagate_into(self.states[m : m + 1], motion, rng, moved[m : m + 1])
        return moved

    def _disturbance(self, bin_: int, k: int) -> NDArray[np.complex128]:
        """Disturbance of one cell, (n_tx n_rx,) complex."""
        array, rng = self._radar.array, generator(self._seed, Purpose.DISTURBANCE, bin_, k)
        return draw(self._world.disturbance.model, array.n_tx * array.n_rx, rng)

    def _echoes(self, k: int) -> dict[int, complex]:
        """Echo amplitude alpha of each occupied bin: known magnitude, phase redrawn every dwell."""
        echoes: dict[int, complex] = {}
        magnitudes = amplitude(amplitude_at_1_km(self._world.echo.amplitude_db), self.range_km**2)
        for m, (bin_, magnitude) in enumerate(zip(self.target_bins.tolist(), magnitudes, strict=True)):
            phase = generator(self._seed, Purpose.PHASE, m, k).uniform(0.0, 2.0 * np.pi)
            echoes[bin_] = echoes.get(bin_, 0j) + cmath.rect(magnitude, phase)
        return echoes
