"""The estimates of `radar.receiver.noise` on recorded I/Q: false alarms of the worst look, and what detection costs.

Targets for P_D have the amplitude that a receiver with known noise detects with probability P_D_KNOWN, so that an
estimate that loses 1 dB at most detects as many with 1 dB more.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import ncx2

from cogradar.services.analysis.tables import Column, Row, Table
from cogradar.services.errors import check_stop
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.detector.levels import range_levels
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.recording import Layout, Recording, read, sha256
from cogradar.shared.signal.waveform import Signatures
from studies.array import sea

P_FA, P_D_KNOWN = 1e-4, 0.8
P_FAS = (1e-2, P_FA)
MORE_DB = 1.0
NOISES = ("lags", "rows", "range-cells")
NUS = np.linspace(-0.5, 0.5, sea.N, endpoint=False)  # of the looks
BESIDE = 1.5 / sea.N  # from the line: looks that it is in the main lobe of
ISOTROPIC = Signatures(float(sea.N), np.empty((sea.N, 0), np.complex128), sea.N)
WITH_TARGET = 10  # one dwell of so many has targets
_KNOWN_LEVELS = 4000  # draws of the level of a look

Floats = NDArray[np.float64]


def statistics(data: list[NDArray[np.complex128]], noise: str) -> Floats:
    """Of all looks in all range cells of a dwell, (n_range, looks); 0 where the noise has no estimate."""
    processing = Processing(is_steered=True, monopulse=False, by_rows=noise != "lags", by_range=noise == "range-cells")
    sets = [DataSet(y, ISOTROPIC, processing) for y in data]
    if noise != "range-cells":
        return np.array([one.tests(NUS).statistic for one in sets])
    powers, levels = np.array([one.powers(NUS) for one in sets]), np.array([one.level for one in sets])
    estimate = range_levels(powers, levels, data[0].size)
    return np.array([one.tests_beside(NUS, estimate).statistic for one in sets])


def measure(file: Path, n_dwell: int, tell: Callable[[str], None], stop: Any) -> list[Row]:
    """A row per estimate, from a recording that is written to a file, and read as a user's."""
    textures = sea.write(file, n_dwell)
    layout = Layout(None, sea.AXES, 1.0, sea.N, sea.N)
    recording, levels = read(file, sha256(file), layout), _known_levels()
    false, blind = np.zeros((len(NOISES), len(P_FAS), NUS.size)), np.zeros((len(NOISES), NUS.size))
    found, n_target = np.zeros((len(NOISES), 2, NUS.size)), 0
    for k in range(n_dwell):
        check_stop(stop)
        data = [recording.at(k, cell, sea.N_RANGE) for cell in range(sea.N_RANGE)]
        for i, noise in enumerate(NOISES):
            tested = statistics(data, noise)
            false[i] += [(tested >= threshold(p_fa)).sum(axis=0) for p_fa in P_FAS]
            blind[i] += (tested == 0.0).sum(axis=0)
        if k % WITH_TARGET == 0:
            found += _detected(recording, k, np.multiply.outer(textures[k], levels))
            n_target += 1
            tell(f"dwell {k} of {n_dwell}")
    n, is_clear = n_dwell * sea.N_RANGE, np.abs(NUS - sea.LINE_NU) > BESIDE
    return [
        {
            "noise": noise,
            "tests": n,
            "worst_2": false[i, 0].max() / n,
            "worst_4": false[i, 1].max() / n,
            "mean_4": false[i, 1, is_clear].mean() / n,
            "blind": 100.0 * blind[i].mean() / n,
            "p_d": found[i, 0, is_clear].mean() / n_target,
            "p_d_more": found[i, 1, is_clear].mean() / n_target,
        }
        for i, noise in enumerate(NOISES)
    ]


def _known_levels() -> Floats:
    """E |alpha_hat|^2 of each look with a texture of 1, (looks,)."""
    rng, processing = np.random.default_rng(0), Processing(is_steered=True, monopulse=False)
    draws = (DataSet(y.ravel(), ISOTROPIC, processing) for y in sea.untextured(rng, _KNOWN_LEVELS))
    return np.asarray(np.mean([one.powers(NUS) for one in draws], axis=0))


def zeta_of_known_noise() -> float:
    """2 |alpha|^2 / E |alpha_hat|^2 of a target that is detected with probability P_D_KNOWN where noise is known."""
    return float(brentq(lambda zeta: ncx2.sf(threshold(P_FA), 2, zeta) - P_D_KNOWN, 1.0, 200.0))


def _detected(recording: Recording, k: int, variances: Floats) -> Floats:
    """Whether the target of each look is detected, in one range cell each, (noises, 2, looks); the second: 1 dB more.

    variances : (n_range, looks) of alpha_hat, of the known noise
    """
    zeta = zeta_of_known_noise()
    cells = (7 * np.arange(NUS.size) + k) % sea.N_RANGE  # 7 and 64 have no common factor: each target has its own
    rng, found = np.random.default_rng(k), np.zeros((len(NOISES), 2, NUS.size))
    phases = np.exp(2j * np.pi * rng.uniform(size=NUS.size))
    for j, more_db in enumerate((0.0, MORE_DB)):
        data = [recording.at(k, cell, sea.N_RANGE) for cell in range(sea.N_RANGE)]
        for i, cell in enumerate(cells.tolist()):
            amplitude = np.sqrt(0.5 * zeta * variances[cell, i]) * 10.0 ** (more_db / 20.0)
            data[cell] += amplitude * phases[i] * np.kron(*ISOTROPIC.at(NUS[i]))
        for which, noise in enumerate(NOISES):
            found[which, j] = statistics(data, noise)[cells, np.arange(NUS.size)] >= threshold(P_FA)
    return found


def table(rows: list[Row]) -> Table:
    columns = (
        Column("noise", "{noise}", left=True),
        Column("tests of a look", "{tests}"),
        Column("worst P_FA at 1e-2", "{worst_2:.4f}"),
        Column("worst P_FA at 1e-4", "{worst_4:.2g}"),
        Column("blind, %", "{blind:.1f}"),
        Column("P_D", "{p_d:.3f}"),
        Column("with 1 dB more", "{p_d_more:.3f}"),
    )
    return Table("Recorded I/Q with a line of 20 dB and an impulsive texture", columns, rows)
