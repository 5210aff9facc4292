"""Rows of a trajectory as one array: a world may have 100 000, which lists would take a third of a second to check."""

import hashlib
from collections.abc import Callable, Iterator
from itertools import chain
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import FailFast, Field, GetCoreSchemaHandler, SerializationInfo, ValidatorFunctionWrapHandler
from pydantic_core import CoreSchema, core_schema

from cogradar.shared.scenario.limits import MAX_HEIGHT_KM, MAX_POSITION_KM, MAX_TIME_S, MIN_ROWS

WIDTHS = (3, 4)  # columns
T = TypeVar("T")
_Lists = Annotated[
    list[Annotated[list[float], Field(min_length=WIDTHS[0], max_length=WIDTHS[1]), FailFast()]],
    FailFast(),  # of many rows the first that is wrong says enough
    Field(min_length=MIN_ROWS),
]


class Rows:
    """[t_s, x_km, y_km], or all of them with z_km, ascending: compared by content, in JSON a list of lists."""

    __slots__ = ("array",)

    def __init__(self, array: NDArray[np.float64]) -> None:
        """`array`: (n, 3 or 4). Raises ValueError for rows that no target can fly."""
        check_rows(array, lambda i: f"row {i + 1}")
        self.array = array
        self.array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.array)

    def __iter__(self) -> Iterator[list[float]]:
        return iter(self.tolist())

    def __getitem__(self, i: int) -> list[float]:
        row: list[float] = self.array[i].tolist()
        return row

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.array, dtype=dtype) if copy is not False else self.array

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rows) and repr(self) == repr(other)

    def __hash__(self) -> int:
        return hash(self.array.tobytes())

    def __repr__(self) -> str:
        return f"Rows({self.array.shape}, {hashlib.blake2b(self.array.tobytes(), digest_size=16).hexdigest()})"

    def tolist(self) -> list[list[float]]:
        """The rows as lists of numbers."""
        rows: list[list[float]] = self.array.tolist()
        return rows

    @classmethod
    def __get_pydantic_core_schema__(cls, _: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        lists = handler.generate_schema(_Lists)
        shown = core_schema.plain_serializer_function_ser_schema(_shown, info_arg=True)
        return core_schema.no_info_wrap_validator_function(_checked, lists, serialization=shown)


def _checked(value: Any, check: ValidatorFunctionWrapHandler) -> Rows:
    """The rows that a value is; what is wrong with lists is said by `check`, which takes ten times as long."""
    if isinstance(value, Rows):
        return value
    if isinstance(value, np.ndarray):
        if value.dtype != np.float64 or value.ndim != 2 or value.shape[1] not in WIDTHS or len(value) < MIN_ROWS:
            raise ValueError(f"must be an array of {MIN_ROWS} or more rows of {' or '.join(map(str, WIDTHS))} numbers")
        return Rows(value)
    rows = value if _are_numbers(value) else check(value)
    n, width = len(rows), len(rows[0])
    if set(map(len, rows)) != {width}:
        i = next(i for i, row in enumerate(rows) if len(row) != width)
        raise ValueError(f"row {i + 1}: all rows must have z_km, or none of them")
    return Rows(np.fromiter(chain.from_iterable(rows), np.float64, n * width).reshape(n, width))


def _are_numbers(value: Any) -> bool:
    """Whether a value is a list of enough rows of floats and small integers."""
    if not isinstance(value, list) or len(value) < MIN_ROWS or set(map(type, value)) != {list}:
        return False
    if not set(map(len, value)).issubset(WIDTHS) or not {*map(type, chain.from_iterable(value))} <= {int, float}:
        return False
    return bool(max(map(abs, chain.from_iterable(value))) <= MAX_TIME_S)


def _shown(rows: Rows, info: SerializationInfo) -> Rows | list[list[float]]:
    return rows.tolist() if info.mode == "json" else rows


def check_rows(rows: NDArray[np.float64], place: Callable[[int], str]) -> None:
    """Raise ValueError for the first row that is not after that before, or too far; `place` is the name of a row.

    rows : (n, 3 or 4)
    """
    t, x, y = rows.T[:3]
    if (early := np.flatnonzero(~(t[1:] > t[:-1]))).size:
        i = int(early[0]) + 1
        raise ValueError(f"{place(i)}: t_s = {t[i]:g} must be above {t[i - 1]:g}, the time of {place(i - 1)}")
    is_near = (np.maximum(np.abs(x), np.abs(y)) <= MAX_POSITION_KM) & (np.abs(t) <= MAX_TIME_S)
    if (far := np.flatnonzero(~is_near)).size:
        raise ValueError(
            f"{place(int(far[0]))}: x_km and y_km must be within {MAX_POSITION_KM:g} km, t_s within {MAX_TIME_S:g} s"
        )
    heights = rows[:, 3:].ravel()
    if (high := np.flatnonzero(~((heights >= 0.0) & (heights <= MAX_HEIGHT_KM)))).size:
        i = int(high[0])
        raise ValueError(f"{place(i)}: z_km = {heights[i]:g}: must be 0 .. {MAX_HEIGHT_KM:g}")
