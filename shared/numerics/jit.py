"""Numba with the project's fixed options: typed for the strict checker, cached on disk, never a stale kernel."""

import atexit
import hashlib
import inspect
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba import types
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.extending import register_jitable

P = ParamSpec("P")
T = TypeVar("T")
_SOURCES = Path(__file__).resolve().parent.parent  # all of `shared`
_IMPORTS = re.compile(r"^\s*(?:from|import)\s+cogradar\.(shared[\w.]*)(?:\s+import\s+(\([^)]*\)|.*))?", re.MULTILINE)
_MAKES_KERNELS = re.compile(r"^from cogradar\.shared\.(numerics\.jit|planning\.problem) import", re.MULTILINE)


def kernel_sources() -> list[Path]:
    """Sources of `shared` that a compiled kernel can depend on: the modules with kernels, and all that they import.

    Messages, the wire and scores are not among them: a change there leaves the kernels as they are.
    """
    texts = {source: source.read_text(encoding="utf-8") for source in _SOURCES.rglob("*.py")}
    found: set[Path] = set()
    left = [source for source, text in texts.items() if _MAKES_KERNELS.search(text)]
    while left:
        source = left.pop()
        if source in texts and source not in found:
            found.add(source)
            left += _imported(texts[source])
    return sorted(found)


def _imported(text: str) -> Iterator[Path]:
    """Files that import statements of `shared` can mean: modules, packages, and names that are modules."""
    for module, names in _IMPORTS.findall(text):
        folder = _SOURCES.joinpath(*module.split(".")[1:])
        yield folder.with_suffix(".py")
        yield folder / "__init__.py"
        yield from (folder / f"{name}.py" for name in re.findall(r"\w+", names))


def cache_dir() -> Path:
    """Folder of the compiled kernels, one per state of their sources.

    Numba stamps a cached kernel with its own file only, so a change in a kernel that was inlined from another file
    would go unseen. A folder named after the sources and the compiler makes that impossible, and `_KernelCache` does
    the same for types declared elsewhere.
    """
    # Numba's index is by path: a second checkout of the same sources would find the mark, but not the kernels.
    digest = hashlib.sha256(f"{numba.__version__} {sys.version} {_SOURCES}".encode())
    for source in kernel_sources():
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
_of_the_folder = cache(lambda: frozenset(kernel_sources()))
CACHED = not _refusal(CACHE_DIR)
numba.config.CACHE_DIR = str(CACHE_DIR)


class _KernelCache(FunctionCache):  # type: ignore[misc] # numba is not typed
    """The compiled versions of one kernel; those for types from other sources have an index of their own.

    Its name has a digest of the files that declare these types: a change of such a file compiles anew, and a program
    that cannot import the types never reads an index that names them.
    """

    _cache_file: Any

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        with self._index_of(sig):
            return super()._load_overload(sig, target_context)

    def _save_overload(self, sig: Any, data: Any) -> None:
        with self._index_of(sig):
            super()._save_overload(sig, data)

    @contextmanager
    def _index_of(self, sig: Any) -> Iterator[None]:
        """Meanwhile the index is that of the argument types; numba holds its compiler lock."""
        own = self._cache_file
        if files := sorted(_foreign_files(sig)):
            digest = hashlib.sha256(b"".join(hashlib.sha256(file.read_bytes()).digest() for file in files))
            name = f"{self._impl.filename_base}-{digest.hexdigest()[:16]}"
            self._cache_file = IndexDataCacheFile(self._cache_path, name, self._impl.locator.get_source_stamp())
        try:
            yield
        finally:
            self._cache_file = own


def _foreign_files(argument_types: Iterable[Any]) -> set[Path]:
    """Files that declare a named tuple among these types and after which the folder is not named."""
    files: set[Path] = set()
    for kind in argument_types:
        if isinstance(kind, types.BaseTuple):
            files |= _foreign_files(kind)
        if isinstance(kind, types.BaseNamedTuple):
            files.add(Path(inspect.getfile(kind.instance_class)).resolve())
    return files - _of_the_folder()


class _Made:
    """What has become of the kernels of this process."""

    any = False  # one was made for the compiler
    interpreted = False  # they run as plain Python


def interpret() -> None:
    """Run all kernels of this process as plain Python. No effect once one was made: compiled ones call only their like.

    For a command that calls few of them: Python takes less than a second where the compiler takes half a minute.
    """
    _Made.interpreted = not _Made.any


def kernel(function: Callable[P, T]) -> Callable[P, T]:
    """Compile `function` in nopython mode on its first call; `.py_func` keeps the plain one.

    `nogil` lets Zenoh's threads run beside a kernel; no `fastmath`, so that a kernel and its plain version round alike.
    """
    if _Made.interpreted:
        return function
    # Kernels of this room call only each other, so that all others may still be interpreted.
    _Made.any = _Made.any or not function.__module__.startswith("cogradar.shared.numerics.")
    dispatcher = numba.njit(nogil=True)(function)
    if CACHED:
        dispatcher._cache = _KernelCache(function)
    return cast(Callable[P, T], dispatcher)


def inlined(function: Callable[P, T]) -> Callable[P, T]:
    """Let kernels call `function`, compiled into each of them; for all others it stays the plain function."""
    return cast(Callable[P, T], register_jitable(inline="always")(function))


class _Compiling(event.Listener):  # type: ignore[misc] # numba is not typed
    """Calls `begin` whenever a function begins to be compiled, and `done` with the last of it and all that it calls."""

    def __init__(self, begin: Callable[[], None], done: Callable[[str, float], None]) -> None:
        self._begin, self._done = begin, done
        self._depth, self._begun_s = 0, 0.0

    def on_start(self, _event: Any) -> None:
        if self._depth == 0:
            self._begun_s = time.monotonic()
        self._depth += 1
        self._begin()

    def on_end(self, ended: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._done(ended.data["dispatcher"].py_func.__qualname__, time.monotonic() - self._begun_s)


@contextmanager
def compiling(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` whenever a function begins to be compiled; it may raise. A kernel with all it calls takes 15 s."""
    with event.install_listener("numba:compile", _Compiling(check, lambda *_: None)):
        yield


@contextmanager
def late_kernels(tell: Callable[[str, float], None]) -> Iterator[None]:
    """Tell of each function that is compiled, and how many seconds it took, with all that it calls."""
    with event.install_listener("numba:compile", _Compiling(lambda: None, tell)):
        yield
