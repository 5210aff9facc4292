"""What a jammer leaves of the bins and of detection, by `radar.receiver.noise`.

Targets for P_D are in the disturbance of `paper`, 25 beams from the jammer, where the beam has a null towards it, and
half a beam nearer, where it has a sidelobe. A receiver with known noise detects them with probability P_D_KNOWN
without a jammer. A receiver that loses 1 dB to a jammer detects as many with 1 dB more.
"""

import numpy as np
from numpy.typing import NDArray

import cogradar
from cogradar.services.analysis.tables import Column, Row, Table
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import Signatures
from cogradar.shared.world.disturbance import draw
from studies.array.noise import MORE_DB, P_FA, zeta_of_known_noise

NOISES = ("lags", "rows")
JNRS_DB = (0.0, 10.0, 20.0)
BEARING_DEG = 38.6  # 25 beams from target 2 of `paper`
DWELLS, SEED = 100, 1
N, DRAWS, BEAMS_OFF = 100, 2000, {"null": 25.0, "lobe": 24.5}
JAMMER_NU = 0.5 * np.sin(np.radians(BEARING_DEG))
ISOTROPIC = Signatures(float(N), np.empty((N, 0), np.complex128), N)


def measure() -> list[Row]:
    """A row per estimate and jammer: all bins of each dwell are tested, by the orthogonal waveform."""
    return [_row(noise, jnr_db) for noise in NOISES for jnr_db in (None, *JNRS_DB)]


def _row(noise: str, jnr_db: float | None) -> Row:
    jammers = "[]" if jnr_db is None else f"[{{bearing_deg = {BEARING_DEG}, jnr_db = {jnr_db}}}]"
    scenario = cogradar.load(
        "paper", ["world.signal=array", f"radar.receiver.noise={noise}", f"world.jammers={jammers}"]
    )
    result = cogradar.run(scenario, strategy="orthogonal", seed=SEED, dwells=DWELLS)
    blind, over = result.sigma_hat == 0.0, result.statistics >= -2.0 * np.log(scenario.radar.detector.p_fa)
    own = np.zeros(blind.shape, np.bool_)
    for beside in (-1, 0, 1):
        np.put_along_axis(own, (result.true_bins + beside) % blind.shape[1], np.True_, axis=1)
    return {
        "noise": noise,
        "jnr": "none" if jnr_db is None else f"{jnr_db:g}",
        "tests": int((~own).sum()),
        "blind": 100.0 * blind.mean(),
        "false": int(over[~own].sum()),
        "nominal": scenario.radar.detector.p_fa * (~own).sum(),
        **{f"p_d_{place}": _p_d(noise, jnr_db, off, 0.0) for place, off in BEAMS_OFF.items()},
        **{f"more_{place}": _p_d(noise, jnr_db, off, MORE_DB) for place, off in BEAMS_OFF.items()},
    }


def _data(rng: np.random.Generator, jnr_db: float | None) -> NDArray[np.complex128]:
    """A data set without a target, (N, N): disturbance, and the jammer independently in each transmit channel."""
    y = draw("ar6-t", N * N, rng).reshape(N, N)
    if jnr_db is not None:
        g = rng.standard_normal((2, N)) * np.sqrt(0.5 * 10.0 ** (jnr_db / 10.0))
        y = y + np.multiply.outer(g[0] + 1j * g[1], ISOTROPIC.at(JAMMER_NU)[1])
    return y


def _p_d(noise: str, jnr_db: float | None, beams_off: float, more_db: float) -> float:
    """Share of targets that are detected so many beams from the jammer."""
    processing, rng = Processing(is_steered=True, monopulse=False, by_rows=noise == "rows"), np.random.default_rng(SEED)
    nus = np.array([JAMMER_NU - beams_off / N])
    clear = [DataSet(_data(rng, None).ravel(), ISOTROPIC, processing).powers(nus)[0] for _ in range(DRAWS)]
    amplitude = np.sqrt(0.5 * zeta_of_known_noise() * np.mean(clear)) * 10.0 ** (more_db / 20.0)
    v, found = np.kron(*ISOTROPIC.at(float(nus[0]))), 0
    for _ in range(DRAWS):
        y = _data(rng, jnr_db).ravel() + amplitude * np.exp(2j * np.pi * rng.uniform()) * v
        found += int(DataSet(y, ISOTROPIC, processing).tests(nus).statistic[0] >= threshold(P_FA))
    return found / DRAWS


def tables(rows: list[Row]) -> list[Table]:
    noise, jnr = Column("noise", "{noise}", left=True), Column("JNR, dB", "{jnr}")
    bins = (
        Column("blind bins, %", "{blind:.1f}"),
        Column("bins without a target", "{tests}"),
        Column("false alarms", "{false}"),
        Column("of nominal", "{nominal:.1f}"),
    )
    detection = (
        Column(title.format(off), f"{{{name}_{place}:.3f}}")
        for place, off in BEAMS_OFF.items()
        for title, name in (("{:g} beams off", "p_d"), ("with 1 dB more", "more"))
    )
    return [
        Table(
            "Bins without an estimate of the noise, `paper`, orthogonal waveform", (noise, jnr, *bins), rows, "noise"
        ),
        Table("P_D beside a jammer, orthogonal waveform", (noise, jnr, *detection), rows, "noise"),
    ]
