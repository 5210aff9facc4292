"""Where the bytes of a feed go: datagrams, a connection, files, standard output."""

import os
import re
import socket
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from cogradar.services.analysis.export.whole import fault_of_folder
from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.feed.output import Format, Output

GAP_S = 0.001  # between datagrams: a burst would overflow the buffers of receivers and switches
CONNECT_S = 2.0
RETRY_S = 1.0  # between attempts to connect again
MOST_ANSWERED = 1 << 20  # bytes, with a picture
DRAIN_S = 0.2  # at most, at the end: with data unread, what was sent last would be lost
_ADDRESS = re.compile(r"(udp|tcp)://(?:\[([0-9A-Fa-f:.%]+)\]|([^\[\]/:\s]+)):(\d{1,5})")


class Transport(Protocol):
    """A way to other systems."""

    done: str  # for people: what has become of pictures that went out, "sent to ..."
    is_answered: bool  # it is known whether they arrive

    def send(self, outputs: Sequence[Output]) -> bool:
        """Send what belongs to one picture; whether it went out. Raises Failure if that is not possible for good."""

    def close(self) -> None:
        """Let go of what is open."""


def transport(
    out: str, form: Format, notify: Callable[[str], None], *, has_files: bool, is_stream: bool, is_dialogue: bool
) -> Transport:
    """The transport that --out names: udp://HOST:PORT, tcp://HOST:PORT, `-`, or a folder for files.

    has_files : the format names its files
    is_stream : its outputs can follow each other in a stream of bytes
    is_dialogue : the other side answers
    Raises BadInput.
    """
    if is_dialogue and not out.startswith("tcp:"):
        raise BadInput(f"--out {out}: this format needs a connection; must be tcp://HOST:PORT")
    if out == "-":
        if not is_stream:
            raise BadInput("--out -: this format has several files; name a folder")
        return Stdout()
    found = _ADDRESS.fullmatch(out)
    if (out.startswith(("udp:", "tcp:")) or "://" in out) and (found is None or not 0 < int(found[4]) < 65536):
        raise BadInput(f"--out {out}: must be udp://HOST:PORT, tcp://HOST:PORT (port 1 to 65535), a folder, or -")
    if found is None:
        if not has_files:
            raise BadInput(f"--out {out}: this format goes to udp://HOST:PORT, tcp://HOST:PORT, or - alone")
        return Folder(out)
    if has_files:
        raise BadInput(f"--out {out}: this format is files; name a folder" + (" or -" if is_stream else ""))
    address = found[2] or found[3], int(found[4])
    return Udp(*address, notify) if found[1] == "udp" else Tcp(*address, form, notify)


class Stdout:
    """Standard output."""

    done, is_answered = "sent to standard output", True

    def send(self, outputs: Sequence[Output]) -> bool:
        """Write all, at once. Raises RunFailed when its reader is gone."""
        try:
            for output in outputs:
                sys.stdout.buffer.write(output.data)
            sys.stdout.buffer.flush()
        except BrokenPipeError:
            with suppress(OSError):
                sys.stdout.close()
            raise RunFailed("standard output: its reader is gone") from None
        return True

    def close(self) -> None:
        """It stays open."""


class Folder:
    """Files in a folder. A reader finds each whole: the old one or the new one."""

    is_answered = True

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        self.done = f"written into {self._folder}"
        if fault := fault_of_folder(folder):
            raise BadInput(f"--out: {fault}")

    def send(self, outputs: Sequence[Output]) -> bool:
        """Replace the files. Raises RunFailed if the system does not let us."""
        for output in outputs:
            part = self._folder / f".{output.file}.{os.getpid()}.part"
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                part.write_bytes(output.data)
                part.replace(self._folder / output.file)
            except OSError as error:
                with suppress(OSError):
                    part.unlink(missing_ok=True)
                raise RunFailed(f"{self._folder / output.file}: {(error.strerror or str(error)).lower()}") from None
        return True

    def close(self) -> None:
        """The files stay."""


class Udp:
    """Datagrams, one for each output, evenly in time."""

    is_answered = False

    def __init__(self, host: str, port: int, notify: Callable[[str], None]) -> None:
        try:
            (family, _, _, _, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            raise BadInput(f"--out udp://{host}:{port}: {_reason(error)}") from None
        self._address, self._notify = address, notify
        self._url = f"udp://{host}:{port}"
        self.done = f"sent to {self._url}"
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._next_s = 0.0
        self._said = ""

    def send(self, outputs: Sequence[Output]) -> bool:
        """Send each. A datagram that finds no receiver or no network is lost, and with it its picture."""
        is_sent = True
        for output in outputs:
            time.sleep(max(0.0, self._next_s - time.monotonic()))
            self._next_s = time.monotonic() + GAP_S
            try:
                self._socket.sendto(output.data, self._address)
            except OSError as error:
                is_sent = False
                text = f"{self._url}: {_reason(error)}; going on"
                if text != self._said:
                    self._notify(text)
                self._said = text
        return is_sent

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Tcp:
    """A connection to a server, made again whenever it is lost; what would have been sent meanwhile is not."""

    is_answered = True

    def __init__(self, host: str, port: int, form: Format, notify: Callable[[str], None]) -> None:
        self._address, self._form, self._notify = (host, port), form, notify
        self._socket: socket.socket | None = None
        self._next_s = 0.0
        self._said = ""
        self._url = f"tcp://{host}:{port}"
        self.done = f"sent to {self._url}"

    def send(self, outputs: Sequence[Output]) -> bool:
        """Send all, if there is a connection or one can be had; where a greeting must come first, that alone."""
        is_new = self._socket is None
        if is_new and not self._connect():
            return False
        greeting = self._form.greeting() if is_new else b""
        try:
            if self._socket is not None:
                answer = self._read(self._socket)
                self._socket.sendall(greeting or answer + b"".join(output.data for output in outputs))
        except OSError as error:
            self._drop()
            self._form.lost()
            self._say(error)
            return False
        return not greeting

    def close(self) -> None:
        """Close the connection, once the server has what was sent, or has had time for it."""
        if self._socket is not None:
            deadline_s = time.monotonic() + DRAIN_S
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_WR)
                while time.monotonic() < deadline_s:
                    self._read(self._socket)
                    time.sleep(GAP_S)
        self._drop()

    def _read(self, connection: socket.socket) -> bytes:
        """Read what the server says; what is to be answered. Raises ConnectionError at its end, RunFailed."""
        answer = b""
        connection.settimeout(0.0)
        try:
            while data := connection.recv(65536):
                answer += self._form.answer(data)
                if len(answer) > MOST_ANSWERED:  # a server that asks without end: the rest waits in its socket
                    return answer
        except BlockingIOError:
            return answer
        finally:
            connection.settimeout(CONNECT_S)
        raise ConnectionResetError("connection closed by the server")

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self) -> bool:
        if time.monotonic() < self._next_s:
            return False
        self._next_s = time.monotonic() + RETRY_S
        try:
            self._socket = socket.create_connection(self._address, CONNECT_S)
        except (OSError, UnicodeError) as error:
            self._say(error)
            return False
        self._said = ""
        return True

    def _say(self, error: OSError | UnicodeError) -> None:
        """Tell once why there is no connection."""
        text = f"{self._url}: {_reason(error)}; trying again"
        if text != self._said:
            self._notify(text)
        self._said = text


def _reason(error: OSError | UnicodeError) -> str:
    return (getattr(error, "strerror", None) or str(error)).lower()
