"""Where HTTP is served: HOST:PORT or the next port that is free, or a socket that another process listens on for us."""

import errno
import ipaddress
import re
import socket

from services.errors import BadInput

DEFAULT = "127.0.0.1:8080"
OFF = ("", "off")
PORTS = 100  # tried, one after the other
BACKLOG = 128
_INHERITED = "fd:"


def listen(text: str) -> socket.socket | None:
    """A listening socket for what `--http` says: HOST:PORT, or its next free port; None if it is off.

    Raises BadInput for anything else, and for an address that this machine does not have.
    """
    if text in OFF:
        return None
    if parent := re.fullmatch(rf"{_INHERITED}(\d{{1,6}})", text):
        return socket.socket(fileno=int(parent[1]))
    place = re.fullmatch(r"(?:\[([0-9a-fA-F:.]+)\]|([^\s:/]+)):(\d{1,5})", text)
    if place is None or int(place[3]) > 65535:
        raise BadInput(f"--http {text}: must be HOST:PORT, such as {DEFAULT}, or off")
    host, first = place[1] or place[2], int(place[3])
    for port in range(first, min(first + PORTS, 65536)):
        try:
            return _bound(host, port)
        except (OSError, UnicodeError) as error:
            if getattr(error, "errno", None) != errno.EADDRINUSE:
                raise BadInput(f"--http {text}: {getattr(error, 'strerror', None) or error}") from None
    raise BadInput(f"--http {text}: this port and the next {PORTS - 1} are taken")


def inherited(listener: socket.socket) -> str:
    """What tells a child process, which inherits it, to serve on this socket."""
    return f"{_INHERITED}{listener.fileno()}"


def url(listener: socket.socket) -> str:
    """Where a browser on this machine finds it."""
    host, port = listener.getsockname()[:2]
    if ipaddress.ip_address(host).is_unspecified:
        host = "127.0.0.1" if listener.family is socket.AF_INET else "::1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def is_loopback(listener: socket.socket) -> bool:
    """Whether only this machine reaches it."""
    return ipaddress.ip_address(listener.getsockname()[0]).is_loopback


def _bound(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # what a process left behind does not count
        listener.bind(where)
        listener.listen(BACKLOG)
    except OSError:
        listener.close()
        raise
    return listener
