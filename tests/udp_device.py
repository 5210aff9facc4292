"""A device that is asked by UDP, as in docs/howto/front-end.md: it loses datagrams and has outages."""

import socket
import struct
import threading
from collections.abc import Collection, Mapping, Sequence
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cogradar.front_end import bin_centres, steering_vector, wald_test

CELL = struct.Struct("<IH5d")


class Device:
    """Targets in white noise, before an array of n x n antennas with n bins; as a context it answers."""

    def __init__(
        self,
        n: int,
        amplitude_db: float,
        targets: Sequence[Sequence[float]],
        loss: float,
        outages: Collection[int],
        listens: tuple[str, int] = ("127.0.0.1", 0),
    ) -> None:
        """targets: [x, vx, y, vy] in dwell 0, km and km per dwell; outages: dwells without an answer."""
        self._n, self._amplitude_db, self._targets = n, amplitude_db, np.array(targets)
        self._loss, self._outages = loss, outages
        self._rng = np.random.default_rng(5)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(listens)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self.sent = self.lost = 0

    @property
    def address(self) -> str:
        host, port = self._socket.getsockname()
        return f"{host}:{port}"

    def positions(self, k: int) -> NDArray[np.float64]:
        """(M, 2) in dwell k, km."""
        return np.asarray(self._targets[:, ::2] + k * self._targets[:, 1::2])

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.sendto(b"", self._socket.getsockname())
        self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        while True:
            asked, reader = self._socket.recvfrom(65536)
            if not asked:
                return
            k, n_bin = struct.unpack_from("<IH", asked)
            bins = np.frombuffer(asked, "<u2", n_bin, 6).tolist()
            w = np.frombuffer(asked, np.complex64, -1, 6 + 2 * n_bin).reshape(self._n, self._n)
            for bin_, cell in self._measured(k, bins, w.astype(np.complex128)).items():
                if k in self._outages or self._rng.random() < self._loss:
                    self.lost += 1
                else:
                    self._socket.sendto(CELL.pack(k, bin_, *cell), reader)
                    self.sent += 1

    def _measured(self, k: int, bins: Sequence[int], w: NDArray[np.complex128]) -> Mapping[int, tuple[float, ...]]:
        n = self._n
        re, im = self._rng.standard_normal((2, n, n)) / np.sqrt(2.0)
        y = re + 1j * im
        for x, across in self.positions(k):
            range_km = np.hypot(x, across)
            alpha = 10.0 ** (self._amplitude_db / 20.0) / range_km**2 * np.exp(2j * np.pi * self._rng.uniform())
            nu = 0.5 * across / range_km
            y += alpha * np.outer(w.T @ steering_vector(nu, n), steering_vector(nu, n))
        found = {}
        for bin_ in bins:
            nu = float(bin_centres(n)[bin_])
            cell = wald_test(y.ravel(), w.T @ steering_vector(nu, n), steering_vector(nu, n))
            alpha = cell.alpha_hat
            found[bin_] = (cell.statistic, alpha.real, alpha.imag, cell.sigma_hat, cell.signature_power)
        return found
