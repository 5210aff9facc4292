"""Where a store is: a file, or a schema of a PostgreSQL server, whose password no one is shown."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from urllib.parse import parse_qsl, quote, unquote, urlencode, urlsplit

from cogradar.services.errors import BadInput

SCHEMES = ("postgresql://", "postgres://")
FORM = "postgresql://[USER@]HOST[:PORT]/DATABASE[?schema=NAME]"
SHORT = "postgresql://..."  # in a line of help
RECORDED = "recorded:"  # before a store: the front end that plays a run of it
DEFAULT_SCHEMA = "cogradar"
_SECRET = {"password", "sslpassword"}  # parameters that are not shown
_QUOTED = re.compile(r"(?i)(postgres(?:ql)?:/+[^\s:@/]*:)\S+(?=@)|(password=)[^\s&]+")


def is_server(name: str) -> bool:
    """Whether a store is on a server."""
    return name.startswith(SCHEMES)


@dataclass(frozen=True)
class Address:
    """Of a store on a server."""

    shown: str  # without passwords
    url: str  # as libpq takes it
    schema: str
    password: str  # in the address itself; "": libpq looks elsewhere
    secrets: tuple[str, ...]

    def __repr__(self) -> str:
        """No secrets, wherever it is printed."""
        return f"Address({self.shown!r})"

    @classmethod
    def of(cls, name: str) -> Self:
        """From what a user gives. Raises BadInput, which does not quote it: there may be a password in it."""
        if re.search(r"(?s)#|[/?@].*@", name.partition("://")[2]):  # there a password ends, and its rest is shown
            raise BadInput("a store on a server: write / # ? @ of a password as %2F %23 %3F %40")
        try:
            parts = urlsplit(name)
            given = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        except ValueError:
            raise BadInput(f"a store on a server: must be {FORM}") from None
        schema = dict(given).get("schema", DEFAULT_SCHEMA)
        if not re.fullmatch(r"(?!pg_)[a-z_][a-z0-9_]{0,62}", schema):
            raise BadInput(f"schema = {schema!r}: must be up to 63 of a-z, 0-9 and _, not begin with a digit or pg_")
        user, at, host = parts.netloc.rpartition("@")
        login, _, password = user.partition(":")
        own = [(key, value) for key, value in given if key != "schema"]
        public = [(key, value) for key, value in given if key not in _SECRET]
        shown = _joined(f"{login}{at}{host}{parts.path}", public)
        url = _joined(f"{parts.netloc}{parts.path}", own)
        secrets = {value for key, value in given if key in _SECRET} | {password, unquote(password)}
        told = dict(given).get("password", unquote(password))  # as libpq has it, the last one
        return cls(shown, url, schema, told, tuple(sorted(secrets - {""}, key=len, reverse=True)))

    def masked(self, text: str) -> str:
        """A text of somebody else, in which a password may be quoted."""
        for secret in self.secrets:
            text = text.replace(secret, "***")
        return text


def _joined(where: str, parameters: list[tuple[str, str]]) -> str:
    """An address; libpq takes no + for a space."""
    query = urlencode(parameters, safe="/:,", quote_via=quote)
    return f"postgresql://{where}{'?' if query else ''}{query}"


def label(name: str) -> str:
    """A short name of a store: of its file without the ending, or of its schema."""
    return Address.of(name).schema if is_server(name) else Path(name).stem


def shown(name: str) -> str:
    """The name of a store as it may be printed."""
    return Address.of(name).shown if is_server(name) else name


def unsaid(text: str) -> str:
    """A text for people, without passwords of addresses that are quoted in it, as of one at a wrong place."""
    return _QUOTED.sub(lambda found: f"{found[1] or found[2]}***", text)


def recording(name: str) -> tuple[str, str]:
    """Store and run of a front end that plays one; "": no run is named. Raises BadInput."""
    whole = name.removeprefix(RECORDED)
    store, _, run = whole.partition("#")
    if is_server(store):
        # A run has no such signs: then it is a part of a password.
        Address.of(whole if "@" in run or _SECRET & dict(parse_qsl(urlsplit(store).query)).keys() else store)
    return store, run


def without_password(name: str) -> tuple[str, str]:
    """The name of a store, or of a front end, as it may be printed, and the password of its server. Raises BadInput."""
    if not name.startswith(RECORDED):
        return shown(name), Address.of(name).password if is_server(name) else ""
    store, run = recording(name)
    told, word = without_password(store)
    return f"{RECORDED}{told}{'#' if run else ''}{run}", word
