"""Compressed files: known by their first bytes, and decompressed while they are read."""

import bz2
import gzip
import io
import lzma
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

from cogradar.services.errors import BadInput

_CURES = {
    b"7z\xbc\xaf": ("7-Zip", "7z x"),
    b"Rar!": ("RAR", "unrar x"),
    b"\x04\x22\x4d\x18": ("LZ4", "lz4 -d"),
    b"\x1f\x9d": ("compress", "uncompress"),
}
_BUFFER = 1 << 16  # bytes


class DamagedFile(Exception):
    """A compressed file is cut short or damaged; the text says how, with the cure, but not which file."""


class _Form(NamedTuple):
    """A form of compression."""

    name: str
    magic: bytes
    opened: Callable[[Path], tuple[IO[bytes], tuple[type[Exception], ...]]]  # and what damaged data raise
    tool: str = ""  # writes what can be decompressed of a damaged file


def opened(file: Path) -> IO[bytes]:
    """The bytes of a file, decompressed. Reading them raises DamagedFile, or OSError.

    Raises BadInput for what cannot be decompressed, with the cure.
    """
    with file.open("rb") as stream:
        head = stream.read(6)
    for form in _FORMS:
        if head.startswith(form.magic):
            packed, damaged = form.opened(file)
            cure = f", or use what there is of it: {form.tool} < {file.name} > part" if form.tool else ""
            return io.BufferedReader(_Unpacked(packed, damaged, form.name, f"fetch it again{cure}"), _BUFFER)
    for magic, (name, tool) in _CURES.items():
        if head.startswith(magic):
            raise BadInput(f"{file}: is compressed with {name}: decompress it first, {tool} {file.name}")
    return file.open("rb")


class _Unpacked(io.RawIOBase):
    """The bytes in a compressed file. Reading raises DamagedFile; a fault of the disk stays an OSError."""

    def __init__(self, stream: IO[bytes], damaged: tuple[type[Exception], ...], name: str, cure: str) -> None:
        self._stream, self._name, self._cure = stream, name, cure
        self._damaged: tuple[type[Exception], ...] = (OSError, *damaged)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True  # Parquet begins at its end

    def readinto(self, buffer: Any) -> int:
        with self._faults():
            data = self._stream.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        with self._faults():
            return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def close(self) -> None:
        self._stream.close()
        super().close()

    @contextmanager
    def _faults(self) -> Iterator[None]:
        try:
            yield
        except EOFError:
            raise DamagedFile(f"is cut short: its {self._name} data end early; {self._cure}") from None
        except self._damaged as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise  # of the disk
            raise DamagedFile(f"is damaged: its {self._name} data say {error}; {self._cure}") from None


def _gzip(file: Path) -> tuple[IO[bytes], tuple[type[Exception], ...]]:
    return cast(IO[bytes], gzip.open(file)), (zlib.error,)


def _bzip2(file: Path) -> tuple[IO[bytes], tuple[type[Exception], ...]]:
    return cast(IO[bytes], bz2.open(file)), ()  # OSError


def _xz(file: Path) -> tuple[IO[bytes], tuple[type[Exception], ...]]:
    return cast(IO[bytes], lzma.open(file)), (lzma.LZMAError,)


def _zstandard(file: Path) -> tuple[IO[bytes], tuple[type[Exception], ...]]:
    try:
        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd
    except ImportError:
        raise BadInput(
            f"{file}: is compressed with Zstandard: pip install 'cogradar[zstd]', or decompress it first:"
            f" zstd -d {file.name}"
        ) from None
    return cast(IO[bytes], zstd.open(file)), (zstd.ZstdError,)


def _zip(file: Path) -> tuple[IO[bytes], tuple[type[Exception], ...]]:
    try:
        with zipfile.ZipFile(file) as archive:
            names = [name for name in archive.namelist() if not name.endswith("/")]
            if len(names) != 1:
                raise BadInput(f"{file}: has {len(names)} files, must be one: unpack it, and name the one, or a folder")
            return archive.open(names[0]), (zipfile.BadZipFile, zlib.error, lzma.LZMAError)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise BadInput(f"{file}: cannot be unpacked: {error}") from None


_FORMS = (
    _Form("gzip", b"\x1f\x8b", _gzip, "zcat"),
    _Form("bzip2", b"BZh", _bzip2, "bzcat"),
    _Form("xz", b"\xfd7zXZ", _xz, "xzcat"),
    _Form("Zstandard", b"\x28\xb5\x2f\xfd", _zstandard, "zstdcat"),
    _Form("ZIP", b"PK\x03\x04", _zip),
)
