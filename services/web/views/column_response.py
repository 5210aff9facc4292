"""Rows as columns: an answer that is drawn."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic_core import to_json
from starlette.responses import Response


def columns(
    head: Mapping[str, Any], names: Sequence[str], rows: Sequence[Mapping[str, Any]], headers: Mapping[str, str]
) -> Response:
    """What is said once, and a list of each of these names; a number that is none is null."""
    document = {**head, **{name: [row[name] for row in rows] for name in names}}
    return Response(to_json(document, inf_nan_mode="null"), headers=headers, media_type="application/json")
