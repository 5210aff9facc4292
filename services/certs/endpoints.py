"""Endpoints of routers, as people write them. It imports nothing slow: a line of help needs it."""

import re

DEFAULT = "tcp/127.0.0.1:7447"
# Protocol and place, then what Zenoh takes besides: ?metadata and #settings of the link.
_ENDPOINT = re.compile(
    r"(?:tcp|tls|udp|quic|ws)/(?:\[[0-9a-fA-F:.%]+\]|[^\[\]/\s:]+):(\d{1,5})(?:[?#]\S*)?|unixsock-stream/\S+"
)


def fault_of(text: str) -> str:
    """What is wrong with endpoints that are separated by commas; empty: nothing."""
    for endpoint in text.split(","):
        found = _ENDPOINT.fullmatch(endpoint)
        if found is None or int(found[1] or 0) > 65535:
            places = f"{DEFAULT}, tls/HOST:PORT, udp/, quic/ or ws/HOST:PORT, unixsock-stream/PATH"
            return f"{endpoint!r} is no endpoint, such as {places}"
    return ""
