"""A front end: two aircraft in white noise. `cogradar run mine.toml --front-end FILE.py:Receiver` drives it."""

import numpy as np
from numpy.typing import NDArray

from cogradar.front_end import ScanData, Settings, Transmission, receive, root, steering_vector

AMPLITUDES = {-0.3: 1.3, 0.2333: 0.9}  # of the echoes, by nu = sin(bearing) / 2; the power of the noise is 1


class Receiver:
    """One run's transmitter and receiver."""

    def __init__(self, settings: Settings) -> None:
        """Switch the hardware on. Raise FrontEndError if it is not there."""
        self._radar = settings.radar
        self._rng = np.random.default_rng(7)

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        """Transmit dwell k, and hand over what the array received."""
        w = root(waveform.isotropic, waveform.factor)  # (n_tx, n_tx)
        return receive(self._received(w), waveform, self._radar)

    def close(self) -> None:
        """Switch the hardware off: the run is over, or the process ends."""

    def _received(self, w: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Y, (n_tx, n_rx) complex: after matched filtering a row for each waveform, a column for each antenna."""
        n_tx, n_rx = self._radar.array.n_tx, self._radar.array.n_rx
        re, im = self._rng.standard_normal((2, n_tx, n_rx)) / np.sqrt(2.0)
        y = re + 1j * im
        for nu, amplitude in AMPLITUDES.items():
            phase = np.exp(2j * np.pi * self._rng.uniform())
            y += amplitude * phase * np.outer(w.T @ steering_vector(nu, n_tx), steering_vector(nu, n_rx))
        return np.asarray(y)
