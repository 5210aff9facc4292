"""Numba with the project's fixed options: typed for the strict checker, cached on disk, never a stale kernel."""

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core import event
from numba.extending import register_jitable

P = ParamSpec("P")
T = TypeVar("T")
_SOURCES = Path(__file__).resolve().parent.parent  # all of `shared`


def cache_dir() -> Path:
    """Folder of the compiled kernels, one per state of the sources.

    Numba stamps a cached kernel with its own file only, so a change in a kernel that was inlined from another file
    would go unseen; a folder named after all sources (and the compiler) makes that impossible.
    """
    # Numba's index is by path: a second checkout of the same sources would find the mark, but not the kernels.
    digest = hashlib.sha256(f"{numba.__version__} {sys.version} {_SOURCES}".encode())
    for source in sorted(_SOURCES.rglob("*.py")):
        digest.update(str(source.relative_to(_SOURCES)).encode())
        digest.update(source.read_bytes())
    root = os.environ.get("COGRADAR_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or _home_cache()
    return Path(root) / "cogradar" / f"kernels-{digest.hexdigest()[:16]}"


def _home_cache() -> str:
    try:
        return str(Path.home() / ".cache")
    except RuntimeError:  # this user has no home
        return os.devnull  # where no folder can be made


def _refusal(folder: Path) -> str:
    """Why nothing can be kept in a folder; empty if it can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _for_this_command() -> Path:
    """A folder that this process and those that it starts share, and that goes with it."""
    root = tempfile.mkdtemp(prefix="cogradar-kernels-")
    atexit.register(shutil.rmtree, root, ignore_errors=True)
    os.environ["COGRADAR_CACHE_DIR"] = root
    return cache_dir()


def _choose() -> tuple[Path, str]:
    folder = cache_dir()
    if not (reason := _refusal(folder)):
        return folder, ""
    try:
        return _for_this_command(), f"{folder}: {reason}"
    except OSError:  # no room for temporary files either
        return folder, f"{folder}: {reason}"


# Of this process, whatever happens to the sources meanwhile; and why it is only of this command, if it is.
CACHE_DIR, NOT_KEPT = _choose()
CACHED = not _refusal(CACHE_DIR)
numba.config.CACHE_DIR = str(CACHE_DIR)


def kernel(function: Callable[P, T]) -> Callable[P, T]:
    """Compile `function` in nopython mode on its first call; `.py_func` keeps the plain one.

    `nogil` lets Zenoh's threads run beside a kernel; no `fastmath`, so that a kernel and its plain version round alike.
    """
    return cast(Callable[P, T], numba.njit(cache=CACHED, nogil=True)(function))


def inlined(function: Callable[P, T]) -> Callable[P, T]:
    """Let kernels call `function`, compiled into each of them; for all others it stays the plain function."""
    return cast(Callable[P, T], register_jitable(inline="always")(function))


@contextmanager
def compiling(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` whenever a function begins to be compiled; it may raise. A kernel with all it calls takes 15 s."""

    class Checking(event.Listener):  # type: ignore[misc] # numba is not typed
        def on_start(self, _event: Any) -> None:
            check()

        def on_end(self, _event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Checking()):
        yield
