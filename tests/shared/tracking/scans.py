"""Scans of the small scenario by hand: two targets in OTHER and BIN, at RANGE_KM."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.scan import Detections

SEED, TARGET, BIN, OTHER = 5, 1, 9, 3
N_BIN, RANGE_KM = 16, 50.0
ALPHA = 10.0 ** (70.0 / 20.0) / RANGE_KM**2  # 1.26, the scenario's echo at that range
LAST = 2  # dwell of the last acquisition scan


def bins_scan(n_bin: int, **columns: Any) -> Detections:
    """A scan of bins, P_FA 10^-4."""
    return Detections.of(columns, n_bin, -2.0 * float(np.log(1e-4)))


def with_beams(scan: Detections, beams: NDArray[np.int32]) -> Detections:
    """The same cells, but these bins lit for the tracks, (M, L)."""
    beam_nus = np.where(beams >= 0, bin_centres(N_BIN)[beams], 0.0)
    return scan._replace(beams=beams, beam_nus=beam_nus, gates=np.zeros((beams.shape[0], 2)))


def scan_of(
    k: int, detected: Sequence[int], power: float, sigma_hat: float, beams: Sequence[int] | None = None
) -> Detections:
    """Every cell, or those of the beams; `detected` have an echo as strong as expected at RANGE_KM, others nothing."""
    cells = np.array(sorted(set(beams or range(N_BIN))), dtype=np.int32)
    alpha_hat = np.where(np.isin(cells, detected), ALPHA, 0.0).astype(np.complex64)
    return bins_scan(
        N_BIN,
        k=k,
        bins=cells,
        statistic=2.0 * np.abs(alpha_hat.astype(np.complex128)) ** 2 / sigma_hat**2,
        alpha_hat=alpha_hat,
        sigma_hat=np.full(cells.size, sigma_hat),
        signature_power=np.full(cells.size, power),
        beams=np.array(beams or [-1, -1], dtype=np.int32)[:, np.newaxis],
    )


ACQUISITION = [scan_of(k, [OTHER, BIN], power=16.0, sigma_hat=0.25) for k in range(LAST + 1)]
HIT = scan_of(LAST + 1, [OTHER, BIN], power=128.0, sigma_hat=0.09, beams=[OTHER, BIN])
MISS = scan_of(LAST + 2, [OTHER], power=4.0, sigma_hat=0.5, beams=[OTHER, BIN])
