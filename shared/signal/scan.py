"""What the receiver says of a dwell: one type of rows, for bins and for steered looks."""

from collections.abc import Callable, Hashable, Mapping
from functools import cached_property
from typing import Any, NamedTuple, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import arcsin
from cogradar.shared.signal.response import grid

Floats = NDArray[np.float64]
Given = TypeVar("Given", bound=Hashable)
Made = TypeVar("Made")


class _Rows(NamedTuple):
    k: int
    bins: NDArray[np.int32]  # (n,) nearest to the directions
    statistic: Floats  # (n,) Lambda
    alpha_hat: NDArray[np.complex64]  # (n,) estimated echo amplitude
    sigma_hat: Floats  # (n,) its estimated standard deviation; 0: none
    signature_power: Floats  # (n,) ||v||^2 of the waveform sent
    beams: NDArray[np.int32]  # (M, L) bins lit for each track, brightest first; -1: none (further)
    nus: Floats  # (n,) directions of the looks, ascending
    limits: Floats  # (n,) what the statistic was compared with
    ranges_km: Floats  # (n,) centre of the range cell; 0: there are none
    nu_hats: Floats  # (n,) measured direction of the echo,
    nu_sigmas: Floats  # (n,) ... its standard deviation; 0: not measured
    beam_nus: Floats  # (M, L) directions of `beams`; 0 where there is none
    gates: Floats  # (M, 2) ranges that were tested for each track, km; (0, 0): all
    unmeasured: Floats | None = None  # (u,) directions of looks that were asked for and have no row; None: all have one
    lost_km: Floats | None = None  # (v,) centres of range cells in which no look measured; None: there are none
    waveform_k: int | None = None  # dwell whose waveform was radiated; None: k-1, the usual one
    # Tracks of an unknown number only.
    ids: NDArray[np.int32] | None = None  # (M,) ascending, of the tracks
    # (M, 5) nu, its standard deviation, range, its standard deviation in km, probability of existence
    expected: Floats | None = None


class Detections(_Rows):
    """The n cells that were tested in dwell k, for M tracks; a look has a row for each range that is reported."""

    @classmethod
    def of(cls, said: Mapping[str, Any], n_bin: int, limit: float) -> Self:
        """From the fields of a message, in which those that bins say by themselves may be None.

        limit : what the statistics of bins are compared with
        """
        columns = {name: said[name] for name in cls._fields if said.get(name) is not None}
        if "nus" not in columns:
            bins, beams, centres = columns["bins"], columns["beams"], grid(n_bin)
            unmeasured, nus = np.zeros(bins.size), centres[bins]
            columns |= {"nus": nus, "limits": np.full(bins.size, limit), "nu_hats": nus}
            columns |= {"ranges_km": unmeasured, "nu_sigmas": unmeasured, "gates": np.zeros((beams.shape[0], 2))}
            columns["beam_nus"] = np.where(beams >= 0, centres[beams], 0.0)
        return cls(**columns)

    def everywhere(self, n_bin: int) -> Self:
        """With a row for each bin, of a scan in which power went everywhere: without a noise estimate, and so without
        a say, for what was not measured.
        """
        if self.unmeasured is None:
            return self
        is_new = np.isin(np.arange(n_bin), self.bins, invert=True)
        at = np.cumsum(~is_new)[is_new]  # rows before which they are put
        blank = dict.fromkeys(("statistic", "alpha_hat", "sigma_hat", "signature_power", "ranges_km"), 0.0)
        blank |= {"nu_sigmas": 0.0, "limits": np.inf}
        filled: dict[str, Any] = {name: np.insert(getattr(self, name), at, value) for name, value in blank.items()}
        centres = grid(n_bin)[is_new]
        filled |= {"bins": np.insert(self.bins, at, np.flatnonzero(is_new)), "nus": np.insert(self.nus, at, centres)}
        return self._replace(**filled, nu_hats=np.insert(self.nu_hats, at, centres))

    @property
    def age(self) -> int:
        """Dwells for which the looks are older than usual: they were asked for when targets were elsewhere."""
        return 0 if self.waveform_k is None else self.k - 1 - self.waveform_k

    def is_unmeasured(self, at: int) -> bool:
        """Whether a look that was made for the track in this row of `beams` was not measured, or nothing was at all."""
        if self.unmeasured is None:
            return False
        lit = self.beam_nus[at][self.beams[at] >= 0]
        return self.nus.size == 0 or bool(np.isin(lit, self.unmeasured).any())

    def is_lost(self, ranges_km: Floats, width_km: float) -> NDArray[np.bool_]:
        """Whether nothing was measured at these ranges, (...), with range cells of this width; (...)."""
        if self.lost_km is None:
            return np.zeros(ranges_km.shape, dtype=np.bool_)
        return np.isin(np.floor(ranges_km / width_km), np.floor(self.lost_km / width_km))

    def is_over(self, rows: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.bool_]:
        """Whether rows are detections, (n,)."""
        return np.asarray(self.statistic[rows] >= self.limits[rows])

    @property
    def is_acquisition(self) -> bool:
        """Whether no cell had been asked for yet."""
        return self.ids is None and bool((self.beams < 0).all())

    def row_of(self, target: int) -> int:
        """Row of a track in beams, gates and expected."""
        return target if self.ids is None else int(np.searchsorted(self.ids, target))

    def once(self, make: Callable[[Self, Given], Made], given: Given) -> Made:
        """make(self, given), which is made once for all tracks that are told of this scan.

        It is made of a copy: a result that holds this scan would be a reference cycle, which only the garbage collector
        frees.
        """
        if (make, given) not in self._made:
            self._made[make, given] = make(self._replace(), given)
        return cast(Made, self._made[make, given])

    @cached_property
    def _made(self) -> dict[Any, Any]:
        return {}


class Strongest(NamedTuple):
    """The statistic of some scans that came nearest to a detection."""

    statistic: float
    limit: float  # that it was compared with
    nu: float

    @classmethod
    def of(cls, scan: Detections, before: Self | None = None) -> Self | None:
        """Of a scan, and what was found in those before it; None: nothing was measured."""
        if not scan.nus.size:
            return before
        at = int(np.argmax(scan.statistic / scan.limits))
        found = cls(float(scan.statistic[at]), float(scan.limits[at]), float(scan.nus[at]))
        return before if before is not None and before.share >= found.share else found

    @property
    def share(self) -> float:
        """Of the limit."""
        return self.statistic / self.limit

    @property
    def angle_deg(self) -> float:
        """Its direction from boresight."""
        return float(np.degrees(arcsin(np.clip(2.0 * self.nu, -1.0, 1.0))))

    def __str__(self) -> str:
        return (
            f"largest statistic {self.statistic:.1f} at {self.angle_deg:.0f} degrees, a detection takes"
            f" {self.limit:.1f}"
        )
