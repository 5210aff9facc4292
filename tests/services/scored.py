"""Rows of the tables `score` and `picture` that tests write out, column by column."""

from collections.abc import Iterable
from typing import Any

from cogradar.shared.scoring.columns import PICTURE, SCORE


def scores(rows: Iterable[tuple[Any, ...]]) -> list[dict[str, Any]]:
    return [dict(zip((column.name for column in SCORE), row, strict=True)) for row in rows]


def pictures(rows: Iterable[tuple[Any, ...]]) -> list[dict[str, Any]]:
    return [dict(zip((column.name for column in PICTURE), row, strict=True)) for row in rows]
