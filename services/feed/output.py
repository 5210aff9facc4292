"""What a format makes of a picture, and what any format is."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from cogradar.services.feed.picture import Picture


class Output(NamedTuple):
    """Bytes that belong together: a datagram, a line, or a file."""

    data: bytes
    file: str = ""  # its name, where outputs replace each other; empty: each is sent once


class Format(Protocol):
    """What tells pictures in the words of other systems. It keeps what it needs to say that a track has ended."""

    wants_plots: bool = False  # pictures are to have the detections of their dwells

    @property
    def is_accepted(self) -> bool:
        """Whether the other side takes pictures by now; `encode` says nothing of them before."""
        return True

    def encode(self, picture: Picture) -> Sequence[Output]:
        """What is to be sent for a picture: all of it, so that a display that joins late has it in one cycle."""

    def greeting(self) -> bytes:
        """What is said first on a connection, before anything else; empty: nothing is."""
        return b""

    def lost(self) -> None:
        """The connection is lost, and with it perhaps what was said on it last."""
        return

    def answer(self, data: bytes) -> bytes:  # noqa: ARG002
        """What is said to what the other side of a connection says. Raises RunFailed if that ends the feed."""
        return b""
