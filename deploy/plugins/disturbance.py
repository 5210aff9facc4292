"""A disturbance: what a cell receives without a target. `--set world.disturbance.model=FILE.py:BURSTS` sets it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Bursts:
    """White, but one cell in ten is four times as strong."""

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
        """Disturbance of one cell and dwell, (n,) complex, power 1 on average; all that is random is of `rng`."""
        level = np.sqrt(np.where(rng.random() < 0.1, 4.0, 1.0) / (2.0 * 1.3))
        return np.asarray(level * (rng.standard_normal(n) + 1j * rng.standard_normal(n)))

    def power_spectrum(self, nu: ArrayLike) -> NDArray[np.float64]:
        """Power spectrum at spatial frequencies, of mean 1; (...) -> (...). Checks and theory need it."""
        return np.ones(np.shape(nu))


BURSTS = Bursts()
