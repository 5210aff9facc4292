"""The reader in C++: compiled where a compiler and Debian's header are, and fed with messages."""

import shutil
import struct
import subprocess
from collections.abc import Iterable
from pathlib import Path

HEADER = Path("/usr/include/msgpack.hpp")
MISSING = (
    "g++ is not installed"
    if shutil.which("g++") is None
    else ""
    if HEADER.exists()
    else "libmsgpack-cxx-dev is not installed"
)
SOURCE = Path(__file__).with_name("reader.cpp")


def compiled(folder: Path) -> Path:
    """The program."""
    program = folder / "reader"
    options = ["-O2", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-DMSGPACK_NO_BOOST"]
    subprocess.run(["g++", *options, "-o", program, SOURCE], check=True, timeout=300)
    return program


def read(program: Path, payloads: Iterable[bytes]) -> list[str]:
    """A line for each message: "same" or "differs", and its content as JSON."""
    return _run([program], payloads).splitlines()


def counted(program: Path, payloads: Iterable[bytes]) -> tuple[int, int, int, float]:
    """Messages; those that it writes back otherwise; numbers in arrays; seconds."""
    n, different, numbers, seconds = _run([program, "count"], payloads).split()
    return int(n), int(different), int(numbers), float(seconds)


def _run(command: list[str | Path], payloads: Iterable[bytes]) -> str:
    framed = b"".join(struct.pack("<I", len(payload)) + payload for payload in payloads)
    done = subprocess.run(command, input=framed, capture_output=True, check=True, timeout=300)
    return done.stdout.decode()
