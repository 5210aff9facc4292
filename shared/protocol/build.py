"""Which build of the program this is: a digest of all that can change what a run comes to."""

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

from cogradar.shared.numerics.fingerprint import arithmetic

_ROOT = Path(__file__).resolve().parents[2]
_SHOWS = {"analysis", "bench", "cli", "sweeps", "web"}  # rooms that only show what runs came to
# What computes or encodes; the others of our dependencies show something, or carry bytes.
LIBRARIES = ("clarabel", "cvxpy", "llvmlite", "msgpack", "numba", "numpy", "pydantic", "pydantic-core", "scipy")


@cache
def build() -> str:
    """Digest of the sources, of the libraries that compute, and of the interpreter; and what this machine computes."""
    digest = hashlib.sha256(platform.python_version().encode())
    for library in LIBRARIES:
        digest.update(f"{library} {version(library)}".encode())
    for source in sources():
        digest.update(source.relative_to(_ROOT).as_posix().encode())
        digest.update(source.read_bytes())
    return f"{digest.hexdigest()[:16]}-{arithmetic()}"


def difference(build: str, system: str) -> str:
    """How a process of one build differs from a system of another one."""
    own, others = (one.partition("-") for one in (build, system))
    if own[0] != others[0]:
        return f"runs build {build}, this system {system}"
    return (
        f"computes otherwise (arithmetic {own[2]}, this system {others[2]}): another C library, or a processor without"
        " fused multiply-add"
    )


def sources() -> list[Path]:
    """Files of the program that can change a result."""
    files = [*sorted((_ROOT / "shared").rglob("*.py")), *sorted((_ROOT / "services").rglob("*.py"))]
    return [file for file in files if _SHOWS.isdisjoint(file.relative_to(_ROOT).parts)]
