"""What all tests share. `shared` is imported before NumPy: it sets the number of linear-algebra threads."""

import hashlib
import os
from importlib import import_module
from pathlib import Path

from hypothesis import settings

# Kernels compiled for the tests' own POMDPs stay out of the user's cache: a program that cannot import `tests` could
# not read an index that names their types. The folder changes with those sources.
_TESTS = Path(__file__).parent
_SOURCES = hashlib.sha256((_TESTS / "oracle_pomcp.py").read_bytes()).hexdigest()[:16]
os.environ["COGRADAR_CACHE_DIR"] = str(_TESTS.parent / "build" / f"test-kernels-{_SOURCES}")

import_module("shared")

# The first example of a property may compile a kernel.
settings.register_profile("cogradar", deadline=None)
settings.load_profile("cogradar")
