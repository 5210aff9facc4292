"""Numba with the project's fixed options: typed for the strict checker, cached on disk, never a stale kernel."""

import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
T = TypeVar("T")


def cache_dir() -> Path:
    """Folder of the compiled kernels, one per state of the sources.

    Numba stamps a cached kernel with its own file only, so a change in a kernel that was inlined from another file
    would go unseen; a folder named after all sources (and the compiler) makes that impossible.
    """
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    root = os.environ.get("COGRADAR_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(root) / "cogradar" / f"kernels-{digest.hexdigest()[:16]}"


CACHE_DIR = cache_dir()  # of this process, whatever happens to the sources meanwhile
numba.config.CACHE_DIR = str(CACHE_DIR)


def kernel(function: Callable[P, T]) -> Callable[P, T]:
    """Compile `function` in nopython mode on its first call; `.py_func` keeps the plain one.

    `nogil` lets Zenoh's threads run beside a kernel; no `fastmath`, so that a kernel and its plain version round alike.
    """
    return cast(Callable[P, T], numba.njit(cache=True, nogil=True)(function))
