"""Bins that a jammer leaves without an estimate of the noise, by `radar.receiver.noise`."""

import numpy as np

import cogradar
from cogradar.services.analysis.tables import Column, Row, Table

NOISES = ("lags", "rows")
JNRS_DB = (0.0, 10.0, 20.0)
BEARING_DEG = 38.6  # 25 beams from target 2 of `paper`
DWELLS, SEED = 100, 1


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
    }


def table(rows: list[Row]) -> Table:
    columns = (
        Column("noise", "{noise}", left=True),
        Column("JNR, dB", "{jnr}"),
        Column("blind bins, %", "{blind:.1f}"),
        Column("bins without a target", "{tests}"),
        Column("false alarms", "{false}"),
        Column("of nominal", "{nominal:.1f}"),
    )
    return Table("Bins without an estimate of the noise, `paper`, orthogonal waveform", columns, rows, "noise")
