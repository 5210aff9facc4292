"""What a user's own thing is called in a run: SOURCE:NAME#HASH, or ENTRY-POINT#HASH.

SOURCE is the name of a Python file without its folder, or a module. HASH is the beginning of the SHA-256 of its source.
So a run says which source it was played with, and nothing in a message names a place on a disk.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core.core_schema import CoreSchema, no_info_after_validator_function

from cogradar.shared.scenario.plugins.kinds import Kind

N_HASH = 16  # hexadecimal digits of a source's hash
MAX_NAME = 120  # characters
OWN = "PATH.py:NAME, package.module:NAME or an entry point"  # what a user's own may be called before a run
_IDENTIFIER = r"[A-Za-z_][A-Za-z0-9_]*"
FILE = r"[A-Za-z0-9_][A-Za-z0-9_.-]*\.py"
MODULE = rf"{_IDENTIFIER}(?:\.{_IDENTIFIER})*"
ENTRY_POINT = r"[A-Za-z0-9_][A-Za-z0-9_.-]*"
# Its length is checked beside it: some readers of JSON schemas know no look-ahead.
PATTERN = rf"^(?:(?:{FILE}|{MODULE}):{_IDENTIFIER}|{ENTRY_POINT})#[0-9a-f]{{{N_HASH}}}$"
_IN_RUN = re.compile(PATTERN)
_SHORT = re.compile(rf"(?:{FILE}|{MODULE}):{_IDENTIFIER}")


class PluginError(ValueError):
    """A user's own thing that cannot be used; the text is for its author and names it."""


class PluginRefused(PluginError):
    """It cannot be had in this process: it is missing, not allowed, has another source, or cannot be imported."""


class PluginFailed(PluginError):
    """It was called and raised, or returned what makes no sense: anybody with this source comes to the same."""


class Name(NamedTuple):
    """The parts of a name."""

    source: str  # file or module; "": an entry point
    attribute: str  # or entry point
    digest: str  # hexadecimal; "": not said

    @classmethod
    def of(cls, text: str) -> "Name":
        """The parts of a text, whatever it is."""
        spec, _, digest = text.partition("#")
        source, _, attribute = spec.rpartition(":")
        return cls(source, attribute, digest)

    @property
    def is_file(self) -> bool:
        """Whether it is in a file, else in an installed module."""
        return self.source.endswith(".py")

    @property
    def short(self) -> str:
        """It without its hash."""
        return f"{self.source}:{self.attribute}" if self.source else self.attribute


def is_own(name: str) -> bool:
    """Whether this is the name of a user's own thing, as a run has it."""
    return len(name) <= MAX_NAME and _IN_RUN.fullmatch(name) is not None


def may_be_own(name: str) -> bool:
    """Whether this may be such a name, or one without the hash of its source."""
    return is_own(name) or (len(name) <= MAX_NAME and _SHORT.fullmatch(name) is not None)


def short(name: str) -> str:
    """A name without the hash of its source."""
    return Name.of(name).short if is_own(name) else name


def without_name(error: Exception, name: str) -> str:
    """What is wrong with a thing of this name, which the line that quotes it says already."""
    return str(error).removeprefix(f"{name}: ").removeprefix(f"{name.rpartition('/')[2]}: ")


def names_of(built_in: Collection[str]) -> str:
    """What may be given, in words."""
    return f"{', '.join(built_in)}{', or ' if built_in else ''}your own: {OWN}"


@dataclass(frozen=True)
class Chosen:
    """A check of a name as a run has it, for the annotation of a field."""

    kind: Kind

    def check(self, name: str) -> str:
        """The name. Raises ValueError."""
        known, is_open = self.kind.built_in, bool(self.kind.protocol)
        if name not in known and not (is_open and is_own(name)):
            raise ValueError(f"must be one of {names_of(known) if is_open else ', '.join(known)}")
        return name

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The check, after the check of a text."""
        return no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """What there is, and what a user's own name looks like."""
        known: dict[str, Any] = {"enum": list(self.kind.built_in)}
        own = {"type": "string", "pattern": PATTERN, "description": f"your own: {OWN}"}
        return handler(schema) | ({"anyOf": [known, own]} if self.kind.protocol else known)
