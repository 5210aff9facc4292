"""Where HTTP is served: HOST:PORT or the next port that is free, or a socket that another process listens on for us."""

import errno
import hmac
import ipaddress
import os
import re
import socket
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cogradar.services.errors import BadInput

DEFAULT = "127.0.0.1:8080"
OFF = ("", "off")
PORTS = 100  # tried, one after the other
BACKLOG = 128
SEND_BUFFER = 64 << 10  # bytes that the system takes (twice that on Linux): a slow client's next event is a new one
GONE_AFTER_MS = 30_000  # without an acknowledgement
HERE = ("localhost", "127.0.0.1", "[::1]")
HOSTS_VARIABLE = "COGRADAR_HTTP_HOSTS"
TOKEN_VARIABLE, TOKEN_FILE_VARIABLE = "COGRADAR_HTTP_TOKEN", "COGRADAR_HTTP_TOKEN_FILE"
COMMAND_VARIABLE, COMMAND_FILE_VARIABLE = "COGRADAR_COMMAND_TOKENS", "COGRADAR_COMMAND_TOKENS_FILE"
FORM = r"[A-Za-z0-9_.~\-]{16,256}"  # of a token; browsers want "-" escaped
_FORM_TEXT = "16 to 256 letters, digits, '_', '.', '~' and '-'"
_INHERITED = re.compile(r"fd:(\d{1,6})/(.+)")
_PLACE = re.compile(r"(?:\[([0-9a-fA-F:.]+)\]|([^\s:/]+)):(\d{1,5})")


@dataclass(frozen=True)
class Admitted:
    """Whose requests are answered."""

    hosts: Collection[str] | None = HERE  # that they are for; None: any
    token: str = ""  # that they show; empty: none
    commanders: Mapping[str, str] = field(default_factory=dict)  # names that may command, by the token that they show
    is_limited: bool = False  # whether each address may ask so often a second and no more

    def commander(self, shown: str) -> str:
        """The name that commands with this token; empty: none."""
        return next((name for token, name in self.commanders.items() if is_same(shown, token)), "")

    def is_known(self, shown: str) -> bool:
        """Whether a token opens what is to be read."""
        return bool(self.token and is_same(shown, self.token)) or bool(self.commander(shown))


def is_same(shown: str, token: str) -> bool:
    """Whether a token is the one that is shown, in a time that tells nothing of it."""
    return hmac.compare_digest(shown.encode(), token.encode())


def listen(text: str) -> socket.socket | None:
    """A listening socket for what `--http` says: HOST:PORT, or its next free port; None if it is off.

    Raises BadInput for anything else, and for an address that this machine does not have.
    """
    if text in OFF:
        return None
    if parent := _INHERITED.fullmatch(text):
        return socket.socket(fileno=int(parent[1]))
    place = _PLACE.fullmatch(text)
    if place is None or int(place[3]) > 65535:
        raise BadInput(f"--http {text}: must be HOST:PORT, such as {DEFAULT}, with a port up to 65535, or off")
    host, first = place[1] or place[2], int(place[3])
    for port in range(first, min(first + PORTS, 65536)):
        try:
            return _bound(host, port)
        except (OSError, UnicodeError) as error:
            if getattr(error, "errno", None) != errno.EADDRINUSE:
                raise BadInput(f"--http {text}: {getattr(error, 'strerror', None) or error}") from None
    raise BadInput(f"--http {text}: this port and the next {PORTS - 1} are taken")


def inherited(listener: socket.socket, text: str) -> str:
    """What tells a child process, which inherits it, to serve on the socket that `listen` made of this text."""
    return f"fd:{listener.fileno()}/{text}"


def allowed(listener: socket.socket, text: str) -> set[str] | None:
    """The hosts that requests may be for, of what `listen` made of this text; None: any, since it is reached from
    elsewhere, and COGRADAR_HTTP_HOSTS does not say under which names.
    """
    host = listener.getsockname()[0]
    given = os.environ.get(HOSTS_VARIABLE, "")
    if not given and not is_loopback(listener):
        return None
    place = _PLACE.fullmatch(text.rpartition("/")[2])
    names = {name.strip().lower() for name in given.split(",") if name.strip()}
    if not ipaddress.ip_address(host).is_unspecified:
        names |= {f"[{host}]" if ":" in host else host, *([place[2].lower()] if place and place[2] else [])}
    return names | set(HERE) if is_loopback(listener) else names


def token() -> str:
    """The token that each request must show: COGRADAR_HTTP_TOKEN, or the first line of the file that
    COGRADAR_HTTP_TOKEN_FILE names; empty: nothing. Raises BadInput.
    """
    lines, source = _secrets(TOKEN_VARIABLE, TOKEN_FILE_VARIABLE)
    given = (lines or [""])[0].strip()
    if source and not re.fullmatch(FORM, given):
        raise BadInput(f"{source}: must be {_FORM_TEXT}")
    return given


def commanders() -> dict[str, str]:
    """The names that may command runs, by token: NAME:TOKEN, several separated by commas, of COGRADAR_COMMAND_TOKENS,
    or a line each of the file that COGRADAR_COMMAND_TOKENS_FILE names. Raises BadInput.
    """
    lines, source = _secrets(COMMAND_VARIABLE, COMMAND_FILE_VARIABLE)
    found = dict[str, str]()
    for given in (part.strip() for line in lines for part in line.split(",")):
        if not given:
            continue
        name, _, shown = given.partition(":")
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,47}", name) or not re.fullmatch(FORM, shown):
            raise BadInput(
                f"{source}: must be NAME:TOKEN, a name of letters and digits; the token must be {_FORM_TEXT}"
            )
        if found.get(shown, name) != name:
            raise BadInput(f"{source}: {found[shown]} and {name} have the same token: each must have its own")
        found[shown] = name
    if name := found.get(token(), ""):
        raise BadInput(f"{source}: the token of {name} is the reading token, {TOKEN_VARIABLE}: must be another one")
    return found


def _secrets(variable: str, file_variable: str) -> tuple[list[str], str]:
    """What a variable says, or the lines of the file that another one names, and which it is. Raises BadInput."""
    given, file = os.environ.get(variable, ""), os.environ.get(file_variable, "")
    if given or not file:
        return [given], variable if given else ""
    source = f"{file_variable}: {file}"
    try:
        return Path(file).read_text(encoding="utf-8").splitlines(), source
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{source}: {getattr(error, 'strerror', None) or 'not a text file'}") from None


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
        # Whom it accepts inherits these.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, GONE_AFTER_MS)
        listener.bind(where)
        listener.listen(BACKLOG)
    except OSError:
        listener.close()
        raise
    return listener
