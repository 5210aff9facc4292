"""Which build of the program this is: a digest of all that can change what a run comes to."""

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
_SHOWS = {"analysis", "bench", "cli", "sweeps", "web"}  # rooms that only show what runs came to
# What computes or encodes; the others of our dependencies show something, or carry bytes.
LIBRARIES = ("clarabel", "cvxpy", "llvmlite", "msgpack", "numba", "numpy", "pydantic", "pydantic-core", "scipy")


@cache
def build() -> str:
    """Digest of the sources, of the libraries that compute, and of the interpreter."""
    digest = hashlib.sha256(f"{platform.python_version()} {platform.machine()}".encode())
    for library in LIBRARIES:
        digest.update(f"{library} {version(library)}".encode())
    for source in sources():
        digest.update(str(source.relative_to(_ROOT)).encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def sources() -> list[Path]:
    """Files of the program that can change a result."""
    files = [*sorted((_ROOT / "shared").rglob("*.py")), *sorted((_ROOT / "services").rglob("*.py"))]
    return [file for file in files if _SHOWS.isdisjoint(file.relative_to(_ROOT).parts)]
