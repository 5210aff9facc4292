"""Recorded I/Q in files of the field, as data sets of an array: what is in a file, and which part a dwell has.

Formats: NumPy (.npy, .npz), MATLAB up to version 7 (.mat), SigMF (.sigmf-meta beside .sigmf-data). A data set is
n_tx n_rx complex numbers, transmit channel by transmit channel.
"""

import hashlib
import json
import re
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 256 << 20  # of a file, and of an array once unpacked: all of it is held in memory
# What readers make of a damaged file.
DAMAGED: tuple[type[Exception], ...] = (
    *(OSError, ValueError, LookupError, TypeError, EOFError, ArithmeticError, MemoryError, AttributeError),
    *(RuntimeError, SyntaxError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)
SMALLEST = 1e-20  # mean power; of noise 1 is meant
_SUMMED = 1 << 16  # numbers of which the squares are summed at once
AXES = ("dwell", "range", "tx", "rx", "channel", "time", "iq")  # what an axis of a recording may count
_CHANNELS = (["tx", "rx"], ["channel"])  # how the channels of a data set may be given; what is missing is in `time`
Wanted = Callable[[str, int], bool]  # whether an array of this name, of so many, is to be read
_MATLAB_NUMBERS = ("double", "single", *(f"{sign}int{n}" for sign in ("", "u") for n in (8, 16, 32, 64)))
_SIGMF = re.compile(r"([cr])(f32|f64|i32|i16|u32|u16|i8|u8)(?:_(le|be))?$")


class RecordingError(ValueError):
    """A file that cannot be used; the text says why."""


class Layout(NamedTuple):
    """How the numbers of a file become data sets."""

    variable: str | None  # of a file with several arrays
    axes: tuple[str, ...]  # what each axis counts
    scale: float | None  # factor of all numbers; None: their mean power becomes 1
    n_tx: int
    n_rx: int


class Recording(NamedTuple):
    """The data sets of a file."""

    data: NDArray[np.complex64]  # (n_dwell, n_range, n_tx n_rx)
    left_over: int  # samples at the end that fill no data set

    def dwells(self, n_cell: int) -> int:
        """How many dwells with n_cell range cells each it has without repetition."""
        return int(self.data.shape[0]) // self._per_dwell(n_cell)

    def at(self, k: int, cell: int, n_cell: int) -> NDArray[np.complex128]:
        """Data set of a range cell, from 0, in dwell k, (n_tx n_rx,), a copy.

        A dwell has n_cell data sets, of as many recorded dwells in a row as that takes, and no data set twice. After
        the last dwell comes the first one again.
        """
        n_range = self.data.shape[1]
        row, column = divmod(cell % n_cell, n_range)
        found = self.data[k % self.dwells(n_cell) * self._per_dwell(n_cell) + row, column]
        return np.asarray(found.astype(np.complex128))

    def _per_dwell(self, n_cell: int) -> int:
        return -(-n_cell // int(self.data.shape[1]))


def sha256(file: Path) -> str:
    """Digest of a recording: of its file, or of both files of a SigMF recording. Raises RecordingError."""
    digest = hashlib.sha256()
    for part in _parts(file):
        digest.update(part.read_bytes())
    return digest.hexdigest()


@lru_cache(maxsize=2)
def read(file: Path, sha: str, layout: Layout) -> Recording:
    """The recording of a file with this digest. Raises RecordingError."""
    found = sha256(file)
    if found != sha:
        raise RecordingError(f"{file}: has sha256 {found[:12]}..., not {sha[:12]}...: it is not the file of the run")
    array, layout = _array(file, layout.variable), layout._replace(axes=tuple(layout.axes))
    if array.dtype.kind not in "fciu" or array.size == 0:
        raise RecordingError(f"{file}: has {array.size} values of type {array.dtype}, must have numbers")
    if array.ndim != len(layout.axes):
        raise RecordingError(
            f"{file}: axes = {list(layout.axes)}: the array has {array.ndim} axes, {array.shape}, name each of them"
        )
    data, left_over = _data_sets(file, _complex(file, array, layout.axes), layout)
    if not np.isfinite(data).all():
        dwell, cell, channel = np.argwhere(~np.isfinite(data))[0].tolist()
        raise RecordingError(
            f"{file}: has NaN or infinity in dwell {dwell}, range cell {cell}, channel {channel}, all from 0: must be"
            " finite, in single precision"
        )
    parts = data.view(np.float32).ravel()
    split = np.split(parts, range(_SUMMED, parts.size, _SUMMED))
    power = sum(float(np.sum(np.square(one, dtype=np.float64))) for one in split) / data.size
    if power == 0.0:
        raise RecordingError(f"{file}: is 0 everywhere, must have a disturbance")
    scale = np.float64(layout.scale or power**-0.5)
    if not SMALLEST <= power * scale**2 <= 1.0 / SMALLEST:
        raise RecordingError(
            f"{file}: has a mean power of {power * scale**2:.3g} after scaling, must be {SMALLEST:g} .."
            f" {1 / SMALLEST:g}: leave scale out, or set one for which it is about 1"
        )
    return Recording((data * scale).astype(np.complex64), left_over)


def _data_sets(file: Path, array: NDArray[np.complex64], layout: Layout) -> tuple[NDArray[np.complex64], int]:
    """(n_dwell, n_range, n_tx n_rx), and how many samples of the time axis are left over."""
    names, left_over = [name for name in layout.axes if name != "iq"], 0
    sizes = {"tx": layout.n_tx, "rx": layout.n_rx, "channel": layout.n_tx * layout.n_rx}
    for name, n in zip(names, array.shape, strict=True):
        if name in sizes and n != sizes[name]:
            of = {"tx": "radar.array.n_tx", "rx": "radar.array.n_rx", "channel": "n_tx n_rx"}[name]
            raise RecordingError(f"{file}: axis {name!r} has {n} values, must have {of} = {sizes[name]}")
    if "time" in names:
        at = names.index("time")
        missing = [name for name in _CHANNELS[0] if name not in names and "channel" not in names]
        block = prod(sizes[name] for name in missing)
        n_dwell, left_over = divmod(array.shape[at], block)
        if n_dwell == 0:
            raise RecordingError(
                f"{file}: axis 'time' has {array.shape[at]} samples, too short: one data set takes {block}"
            )
        cut = np.moveaxis(np.moveaxis(array, at, 0)[: n_dwell * block], 0, at)
        array = cut.reshape(*cut.shape[:at], n_dwell, *(sizes[name] for name in missing), *cut.shape[at + 1 :])
        names[at : at + 1] = ["dwell", *missing]
    channels = next((found for found in _CHANNELS if set(found) <= set(names)), None)
    if channels is None:
        raise RecordingError(
            f"{file}: axes = {list(layout.axes)}: must have 'tx' and 'rx', or 'channel', or 'time' in which they are"
        )
    for name in ("range", "dwell"):
        if name not in names:
            array, names = array[np.newaxis], [name, *names]
    order = [names.index(name) for name in ("dwell", "range", *channels)]
    array = np.transpose(array, order)
    return np.ascontiguousarray(array.reshape(*array.shape[:2], -1)), left_over


def _complex(file: Path, array: NDArray[Any], axes: Sequence[str]) -> NDArray[np.complex64]:
    if "iq" not in axes:
        if array.dtype.kind != "c":
            raise RecordingError(
                f"{file}: has real numbers ({array.dtype}), must be complex, or have an axis 'iq' of 2: I and Q"
            )
        with np.errstate(over="ignore"):  # what is beyond is infinite, and refused
            return array.astype(np.complex64, copy=False)
    at = list(axes).index("iq")
    if array.dtype.kind == "c" or array.shape[at] != 2:
        raise RecordingError(f"{file}: axis 'iq' must have 2 real numbers, has {array.shape[at]} of {array.dtype}")
    with np.errstate(over="ignore", invalid="ignore"):
        i, q = np.moveaxis(array, at, 0).astype(np.float32)
        return np.asarray(i + 1j * q, np.complex64)


def _parts(file: Path) -> list[Path]:
    """The files of a recording. Raises RecordingError."""
    parts = [file]
    if file.suffix in {".sigmf-meta", ".sigmf-data"}:
        parts = [file.with_suffix(".sigmf-meta"), file.with_suffix(".sigmf-data")]
    elif file.suffix not in _READERS:
        raise RecordingError(f"{file}: must end with {', '.join(_READERS)}")
    for part in parts:
        if not part.is_file():
            raise RecordingError(f"{part}: {'not a regular file' if part.exists() else 'no such file'}")
        if part.stat().st_size > MAX_BYTES:
            raise RecordingError(f"{part}: larger than {MAX_BYTES >> 20} MiB, too large: cut a part of it")
    return parts


def arrays_in(file: Path, variable: str | None = None, *, every: bool = False) -> dict[str, NDArray[Any] | None]:
    """The arrays of a file by name, "" of a file that has one without a name. Raises RecordingError.

    variable : the one that is wanted; others are named only. None: the only one
    every    : all of them are wanted
    """
    _parts(file)
    try:
        found = _READERS[file.suffix](file, lambda name, n: every or name == variable or (variable is None and n == 1))
    except RecordingError:
        raise
    except DAMAGED as error:
        raise RecordingError(f"{file}: no {file.suffix} file: {' '.join(str(error).split())[:120]}") from None
    for name, array in found.items():
        if array is not None and not isinstance(array, np.ndarray):
            raise RecordingError(f"{file}: {name or 'its content'} is no array")
    return found


def _array(file: Path, variable: str | None) -> NDArray[Any]:
    arrays = arrays_in(file, variable)
    if variable is None and len(arrays) == 1:
        variable = next(iter(arrays))
    names = ", ".join(list(arrays)[:20]) or "none"
    if variable is None:
        raise RecordingError(f"{file}: has {len(arrays)} arrays, set variable to one of: {names}")
    if variable not in arrays:
        raise RecordingError(f"{file}: variable = {variable!r}: no such array, must be one of: {names}")
    found = arrays[variable]
    if found is None:
        raise RecordingError(f"{file}: variable = {variable!r}: is no array of numbers")
    return found


def _check_size(file: Path, name: str, n_byte: int) -> None:
    if n_byte > MAX_BYTES:
        raise RecordingError(
            f"{file}: {name or 'its array'} takes {n_byte >> 20} MiB of memory, must take {MAX_BYTES >> 20} MiB at"
            " most: cut a part of it"
        )


def _npy(file: Path, _is_wanted: Wanted) -> dict[str, Any]:
    with file.open("rb") as stream:  # which NumPy leaves open if it is damaged
        return {"": np.load(stream, allow_pickle=False)}


def _npz(file: Path, is_wanted: Wanted) -> dict[str, Any]:
    with zipfile.ZipFile(file) as members:
        sizes = {info.filename.removesuffix(".npy"): info.file_size for info in members.infolist()}
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
        wanted = [name for name in arrays.files if is_wanted(name, len(arrays.files))]
        _check_size(file, ", ".join(wanted), sum(sizes[name.removesuffix(".npy")] for name in wanted))
        return {name: arrays[name] if name in wanted else None for name in arrays.files}


def _mat(file: Path, is_wanted: Wanted) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        shapes = {name: shape for name, shape, kind in whosmat(file) if kind in _MATLAB_NUMBERS}
        wanted = [name for name in shapes if is_wanted(name, len(shapes))]
        _check_size(file, ", ".join(wanted), sum(prod(shapes[name]) * 8 for name in wanted))
        return dict.fromkeys(shapes) | {name: loadmat(file, variable_names=[name])[name] for name in wanted}
    except MatReadError as error:
        raise ValueError(*error.args) from None
    except NotImplementedError:
        raise RecordingError(f"{file}: is of MATLAB 7.3: save it with '-v7', or as .npy") from None


def _sigmf(file: Path, _is_wanted: Wanted) -> dict[str, Any]:
    """Samples, (n,), or (n, channels) of several channels."""
    meta = json.loads(file.with_suffix(".sigmf-meta").read_text(encoding="utf-8"))
    head = meta["global"]
    elsewhere = [key for key in ("core:dataset", "core:trailing_bytes", "core:metadata_only") if head.get(key)]
    elsewhere += ["core:header_bytes" for capture in meta.get("captures", []) if capture.get("core:header_bytes")]
    if elsewhere:
        raise RecordingError(f"{file}: {elsewhere[0]}: samples must be all of the .sigmf-data beside it")
    match = _SIGMF.match(str(head["core:datatype"]))
    if match is None:
        raise RecordingError(f"{file}: core:datatype = {head['core:datatype']!r}: unknown, must be such as cf32_le")
    kind, number, order = match.groups()
    dtype = np.dtype(f"{'>' if order == 'be' else '<'}{number[0]}{int(number[1:]) // 8}")
    found: NDArray[Any] = np.fromfile(file.with_suffix(".sigmf-data"), dtype)
    if number[0] == "u":  # unsigned I and Q are around the middle of their range
        found = found.astype(np.float32) - 0.5 * (np.iinfo(dtype).max + 1.0)
    if kind == "c":
        pairs = found[: found.size // 2 * 2].astype(np.float32).reshape(-1, 2)
        found = pairs[:, 0] + 1j * pairs[:, 1]
    n = int(head.get("core:num_channels", 1))
    return {"": found if n == 1 else found[: found.size // n * n].reshape(-1, n)}


_READERS: dict[str, Callable[[Path, Wanted], dict[str, Any]]] = {
    ".npy": _npy,
    ".npz": _npz,
    ".mat": _mat,
    ".sigmf-meta": _sigmf,
    ".sigmf-data": _sigmf,
}
