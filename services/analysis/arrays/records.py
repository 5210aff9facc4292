"""Tables of a run as NumPy structured arrays: one row per detection, track, target or waveform of a dwell.

Lengths are in km, velocities in km/s, times in s; dwells `k` count from 0, `t` from 1 after the acquisition. Tracks and
targets count from 1.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.services.analysis.optional import library
from cogradar.shared.protocol.messages import ABSENT, Plan, Scan, Truth, Waveform
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scoring.scan_rows import ScanRows, row_of_track
from cogradar.shared.signal.response import strongest_of_each

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import xarray as xr

Columns = dict[str, NDArray[Any]]


class Records(np.ndarray):  # a structured array, whose kind is not known to the types
    """A structured array, (n,): `rows["range_km"]` is a column, `rows[rows["t"] == 5]` are some of its rows."""

    @classmethod
    def of(cls, given: Mapping[str, NDArray[Any]]) -> Self:
        """Of columns of one length, (n, ...) each."""
        size = next(iter(given.values())).shape[0]
        kinds = [(name, values.dtype, values.shape[1:]) for name, values in given.items()]
        found = np.empty(size, dtype=kinds)
        for name, values in given.items():
            found[name] = values
        return found.view(cls)

    def columns(self, *, real: bool = True) -> Columns:
        """Its columns; one of vectors or matrices is a column for each element, such as `covariance_0_2`.

        real : of complex numbers there is a column `_real` and one `_imag`
        """
        return flat({name: np.asarray(self[name]) for name in self.dtype.names or ()}, real=real)

    def to_pandas(self) -> "pd.DataFrame":
        """A data frame with a column for each of `columns(real=False)`. Raises BadInput without pandas."""
        frame: pd.DataFrame = library("pandas", "frames").DataFrame(self.columns(real=False))
        return frame

    def to_polars(self) -> "pl.DataFrame":
        """A data frame with a column for each of `columns`. Raises BadInput without polars."""
        frame: pl.DataFrame = library("polars", "frames").DataFrame(self.columns())
        return frame

    def to_xarray(self) -> "xr.Dataset":
        """A data set with dimension `row`; one of vectors or matrices has further ones.

        Raises BadInput without xarray.
        """
        variables = {}
        for name in self.dtype.names or ():
            values = np.asarray(self[name])
            variables[name] = (("row", *(f"{name}_{i}" for i in range(values.ndim - 1))), values)
        found: xr.Dataset = library("xarray", "frames").Dataset(variables)
        return found


def flat(columns: Mapping[str, NDArray[Any]], *, real: bool = True) -> Columns:
    """Columns of one number or text in a row each: of vectors and matrices one for each element, `covariance_0_2`.

    real : of complex numbers there is a column `_real` and one `_imag`
    """
    found: Columns = {}
    for name, values in columns.items():
        for at in np.ndindex(values.shape[1:]):
            found |= _parts("_".join([name, *map(str, at)]), values[(slice(None), *at)], real=real)
    return found


def in_parts(columns: Mapping[str, NDArray[Any]]) -> Columns:
    """The same columns, a complex one as two: `_real` and `_imag`."""
    return {part: one for name, values in columns.items() for part, one in _parts(name, values).items()}


def _parts(name: str, values: NDArray[Any], *, real: bool = True) -> Columns:
    is_split = real and values.dtype.kind == "c"
    return {f"{name}_real": values.real, f"{name}_imag": values.imag} if is_split else {name: values}


def detections(
    radar: RadarConfig, scans: Iterable[Scan], truths: Mapping[int, Truth] | None, *, all_looks: bool = False
) -> Records:
    """A row per tested cell over its limit, in the order of dwell and direction; with `all_looks` per tested cell.

    A look that tests several range cells reports those with a target and the loudest other one. So a simulated look
    has no more than one false alarm. A target between two looks, or two range cells, is over the limit in both.

    truths : by dwell k; None where there is no truth, and no column `target`

    k, t, t_s         : dwell; t is 0 during an acquisition, when targets stand still
    nu                : direction of the look, 0.5 sin(angle)
    angle_deg         : this direction, from boresight
    nu_measured       : direction of the echo, by monopulse; NaN if it was not measured, as the next one
    nu_measured_sigma : its standard deviation
    range_km          : centre of the range cell; NaN without range cells, as the next one
    range_cell_km     : its width
    statistic, limit  : Wald-type statistic Lambda, and what it was compared with
    is_over           : whether it is over the limit; with `all_looks` only
    p_fa              : probability that a cell with nothing but disturbance is over this limit, exp(-limit / 2)
    alpha_hat         : estimated echo amplitude, complex
    sigma_hat         : its estimated standard deviation
    signature_power   : ||v||^2 of what was radiated in this direction
    strongest         : 1 of the strongest of the rows that may be one echo, as trackers take it; 0 of the others
    target            : target in the cell, from 1; 0: none, a false alarm
    """
    rows = ScanRows.of(radar)
    parts = [_cells(rows, scan, truths, all_looks=all_looks) for scan in scans]
    empty: Columns = {name: np.empty(0, kind) for name, kind in _DETECTED.items()}
    found = {name: np.concatenate([empty[name], *(part[name] for part in parts)]) for name in _DETECTED}
    width = np.where(np.isnan(found["range_km"]), np.nan, radar.receiver.range_cell_km)
    worked_out = {
        "t_s": found["t"] * radar.motion.dt_s,
        "angle_deg": np.degrees(np.arcsin(np.clip(2.0 * found["nu"], -1.0, 1.0))),
        "range_cell_km": width,
        "p_fa": np.exp(-0.5 * found["limit"]),
    }
    found |= worked_out
    left_out = {name for name, is_out in (("is_over", not all_looks), ("target", truths is None)) if is_out}
    return Records.of({name: found[name] for name in _ORDER if name not in left_out})


_DETECTED = {  # what comes from the scans
    "k": np.int64,
    "t": np.int64,
    "nu": np.float64,
    "nu_measured": np.float64,
    "nu_measured_sigma": np.float64,
    "range_km": np.float64,
    "statistic": np.float64,
    "limit": np.float64,
    "is_over": np.bool_,
    "alpha_hat": np.complex128,
    "sigma_hat": np.float64,
    "signature_power": np.float64,
    "strongest": np.int64,
    "target": np.int64,
}
_ORDER = (
    *("k", "t", "t_s", "nu", "angle_deg", "nu_measured", "nu_measured_sigma", "range_km", "range_cell_km"),
    *("statistic", "limit", "is_over", "p_fa", "alpha_hat", "sigma_hat", "signature_power", "strongest", "target"),
)


def _cells(rows: ScanRows, scan: Scan, truths: Mapping[int, Truth] | None, *, all_looks: bool) -> Columns:
    seen = rows.read(vars(scan))
    over = np.flatnonzero(seen.is_over())
    strongest = np.zeros(seen.statistic.size, dtype=np.int64)
    found = strongest_of_each(rows.response, seen.statistic[over], seen.nus[over], seen.ranges_km[over])
    strongest[over[found]] = 1
    at = np.arange(seen.statistic.size) if all_looks else over
    is_measured, has_range = seen.nu_sigmas[at] > 0.0, seen.ranges_km[at] > 0.0
    truth = (truths or {}).get(scan.k)
    target = np.zeros(seen.statistic.size, dtype=np.int64)
    if truth is not None:
        there = np.flatnonzero(truth.bins != ABSENT)[::-1]
        held = rows.holds(seen, truth.measured_states[there])
        for one, is_held in zip(there.tolist(), held, strict=True):
            target[is_held] = one + 1
    return {
        "k": np.full(at.size, scan.k),
        "t": np.full(at.size, scan.t),
        "nu": seen.nus[at],
        "nu_measured": np.where(is_measured, seen.nu_hats[at], np.nan),
        "nu_measured_sigma": np.where(is_measured, seen.nu_sigmas[at], np.nan),
        "range_km": np.where(has_range, seen.ranges_km[at], np.nan),
        "statistic": seen.statistic[at],
        "limit": seen.limits[at],
        "is_over": np.isin(at, over),
        "alpha_hat": seen.alpha_hat[at],
        "sigma_hat": seen.sigma_hat[at],
        "signature_power": seen.signature_power[at],
        "strongest": strongest[at],
        "target": target[at],
    }


def tracks(
    dt_s: float,
    plans: Iterable[Plan],
    sent: Mapping[int, Waveform],
    followed: Mapping[tuple[int, int], int] | None = None,
) -> Records:
    """A row per dwell and track that is followed.

    sent     : by the dwell in which it was radiated
    followed : target of dwell k and track, both as in the rows; None: not known, and no column `target`

    k, t, t_s      : dwell
    track          : its number
    confirmed      : or tentative
    existence      : probability that there is a target; NaN if their number is known
    x_hat .. vy_hat: mean of the belief after the dwell's scan
    covariance     : (4, 4) of the belief about [x, vx, y, vy]
    gain           : statistic's noncentrality of the cell with the target, over its beam power
    detected       : a cell that it asked for was over its limit
    share          : power on its beams, linear
    n_sim          : simulations behind its next choice
    target         : target that it follows; 0: none
    """
    rows = [
        (
            *(plan.k, plan.t, plan.t * dt_s, plan.target + 1, plan.confirmed is not False),
            *(np.nan if plan.existence is None else plan.existence, *plan.estimate.tolist(), plan.covariance),
            *(plan.gain, plan.detected, _share(sent.get(plan.k), plan.target), plan.n_sim),
            (followed or {}).get((plan.k, plan.target + 1), 0),
        )
        for plan in plans
        if plan.status == "tracking"
    ]
    kinds: list[tuple[Any, ...]] = [("k", np.int64), ("t", np.int64), ("t_s", np.float64), ("track", np.int64)]
    kinds += [("confirmed", np.bool_), *((name, np.float64) for name in ("existence", "x_hat", "vx_hat"))]
    kinds += [("y_hat", np.float64), ("vy_hat", np.float64), ("covariance", np.float64, (4, 4)), ("gain", np.float64)]
    kinds += [("detected", np.bool_), ("share", np.float64), ("n_sim", np.int64)]
    if followed is None:
        return np.array([row[:-1] for row in rows], dtype=kinds).view(Records)
    return np.array(rows, dtype=[*kinds, ("target", np.int64)]).view(Records)


def _share(sent: Waveform | None, track: int) -> float:
    row = -1 if sent is None else row_of_track(vars(sent), track)
    return float("nan") if sent is None else float(sent.shares[row].sum()) if row >= 0 else 0.0


def requests(dt_s: float, n_bin: int, plans: Iterable[Plan]) -> Records:
    """A row per dwell, track and cell that the track asks to be lit in the next dwell.

    k, t, t_s : dwell after which it is asked for
    track     : its number
    bin       : angle bin of the cell
    nu        : its direction, 0.5 sin(angle)
    chance    : probability that the target will be in it
    is_best   : whether it is in the most probable bin
    range_km  : expected range of the target
    gain      : statistic's noncentrality of the cell with the target, over its beam power
    n_sim     : simulations behind the choice
    """
    rows = [
        (plan.k, plan.t, plan.t * dt_s, plan.target + 1, one, nu, chance, one == plan.best_bin, *of_plan)
        for plan in plans
        for of_plan in [(plan.range_km, plan.gain, plan.n_sim)]
        for one, nu, chance in zip(
            plan.bins.tolist(),
            (plan.bins / (n_bin - 1) - 0.5 if plan.nus is None else plan.nus).tolist(),
            plan.chances.tolist(),
            strict=True,
        )
    ]
    kinds: list[tuple[Any, ...]] = [("k", np.int64), ("t", np.int64), ("t_s", np.float64), ("track", np.int64)]
    kinds += [("bin", np.int64), ("nu", np.float64), ("chance", np.float64), ("is_best", np.bool_)]
    kinds += [("range_km", np.float64), ("gain", np.float64), ("n_sim", np.int64)]
    return np.array(rows, dtype=kinds).view(Records)


def truth(dt_s: float, truths: Iterable[Truth]) -> Records:
    """A row per dwell and target that is there.

    k, t, t_s : dwell
    target    : its number
    x .. vy   : its state on the ground
    z         : its height
    bin       : the angle bin that it is measured in
    snr_db    : signal-to-noise ratio per virtual channel, before the array's gain
    """
    rows = [
        (one.k, one.t, one.t * dt_s, m + 1, *one.states[m].tolist(), one.heights_km[m], one.bins[m], one.snr_db[m])
        for one in truths
        for m in np.flatnonzero(one.bins != ABSENT).tolist()
    ]
    kinds = [("k", np.int64), ("t", np.int64), ("t_s", np.float64), ("target", np.int64)]
    kinds += [(name, np.float64) for name in ("x", "vx", "y", "vy", "z")]
    return np.array(rows, dtype=[*kinds, ("bin", np.int64), ("snr_db", np.float64)]).view(Records)


def waveforms(dt_s: float, dwells: Sequence[tuple[int, int]], sent: Mapping[int, Waveform], n_tx: int) -> Records:
    """A row per dwell, of which the covariance of what it radiated is R = isotropic / n_tx I + factor factor^H.

    dwells : k and t of each
    sent   : by the dwell in which it was radiated

    k, t, t_s : dwell
    k_made    : dwell after which it was made, in real time an older one than k-1 if that came late; -1: not stored
    isotropic : power spread evenly over all directions; NaN if it is not stored, as the next one
    factor    : (n_tx, r) complex; columns of zeros where it has fewer
    """
    rank = max((sent[k].factor.shape[1] for k, _ in dwells if k in sent), default=0)
    kinds: list[tuple[Any, ...]] = [("k", np.int64), ("t", np.int64), ("t_s", np.float64), ("k_made", np.int64)]
    kinds += [("isotropic", np.float64), ("factor", np.complex128, (n_tx, rank))]
    found = np.zeros(len(dwells), dtype=kinds).view(Records)
    for i, (k, t) in enumerate(dwells):
        row = found[i : i + 1]
        row["k"], row["t"], row["t_s"], row["k_made"] = k, t, t * dt_s, -1
        if (one := sent.get(k)) is None:
            row["isotropic"] = row["factor"] = np.nan
            continue
        row["k_made"], row["isotropic"] = one.k, one.isotropic
        row["factor"][0, :, : one.factor.shape[1]] = one.factor
    return found
