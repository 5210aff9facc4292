"""Libraries that few installations need."""

from importlib import import_module
from typing import Any

from cogradar.services.errors import MissingLibrary


def library(module: str, extra: str, purpose: str = "this") -> Any:
    """A module of a library that is an extra of ours. Raises MissingLibrary, with the command that installs it."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingLibrary(f"{purpose} needs {module.partition('.')[0]}: pip install 'cogradar[{extra}]'") from None
