"""udp_receiver.py: a device that tests the cells itself, by UDP."""

import os
import socket
import struct
import time

import numpy as np

from cogradar.front_end import ScanData, Settings, Transmission, root

CELL = struct.Struct(
    "<IH5d"
)  # dwell, bin, statistic, re and im of the amplitude, its deviation, power of the signature


class UdpReceiver:
    """One run's device."""

    def __init__(self, settings: Settings) -> None:
        """Where the device is and how long to wait for it."""
        host, port = os.environ.get("RADAR_DEVICE", "127.0.0.1:7000").rsplit(":", 1)
        self._device = host, int(port)
        self._wait_s = 0.4 / settings.rate_hz if settings.rate_hz else 0.5
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        """Have dwell k transmitted, and take what comes of it in time."""
        w = root(waveform.isotropic, waveform.factor).astype(np.complex64)
        head = struct.pack("<IH", k, waveform.bins.size)
        self._socket.sendto(head + waveform.bins.astype("<u2").tobytes() + w.tobytes(), self._device)
        cells: dict[int, list[float]] = {}
        until_s = time.monotonic() + self._wait_s
        while len(cells) < waveform.bins.size and (left_s := until_s - time.monotonic()) > 0.0:
            self._socket.settimeout(left_s)
            try:
                number, bin_, *values = CELL.unpack(self._socket.recv(2048))
            except TimeoutError:
                break
            if number == k:
                cells[bin_] = values
        if not cells:
            return ScanData.not_measured(f"no datagram from {self._device[0]}:{self._device[1]}")
        bins = sorted(cells)
        statistic, re, im, sigma, power = np.array([cells[bin_] for bin_ in bins]).T
        return ScanData(np.array(bins, np.int32), statistic, re + 1j * im, sigma, power)

    def close(self) -> None:
        """Let the device go."""
        self._socket.close()
