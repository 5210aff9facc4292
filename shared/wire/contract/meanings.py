"""What the fields of a message mean: the comments beside them, which are written once, in the source of the message."""

import inspect
import re
from functools import cache
from typing import Final

from pydantic import BaseModel

_FIELD = re.compile(r"    (\w+): .*?(?:\s+# (.*))?")
_COMMENT = re.compile(r"    # (.*)")
_SHAPE = re.compile(r"\((?:\w+,|\w+(?:, \w+)+)\)")
_UNITS: Final = {"_km": "km", "_s": "s", "_hz": "Hz", "_db": "dB", "_deg": "deg"}


def meanings(kind: type[BaseModel]) -> dict[str, str]:
    """Text of each field that has a comment: behind it, or in lines of their own just before it."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, BaseModel) and base is not BaseModel:
            found |= _beside(base)
    return {name: text for name, text in found.items() if name in kind.model_fields}


@cache  # to find the source of a class takes longer than all else of a schema
def _beside(kind: type[BaseModel]) -> dict[str, str]:
    found: dict[str, str] = {}
    before: list[str] = []
    for line in inspect.getsource(kind).splitlines():
        if comment := _COMMENT.fullmatch(line):
            before.append(comment[1])
            continue
        if field := _FIELD.fullmatch(line):
            text = field[2] or " ".join(before)
            if text:
                found[field[1]] = text
        before = []
    return found


def shape(meaning: str) -> str:
    """Shape that a meaning begins with, such as (M, L); "" if none."""
    found = _SHAPE.match(meaning)
    return found[0] if found else ""


def unit(name: str) -> str:
    """Unit in the name of a field; "" if none."""
    return next((unit for end, unit in _UNITS.items() if name.endswith(end)), "")
