"""What can be said of a core's state after every event, and is not true only if the program is wrong."""

from typing import Protocol, runtime_checkable


class BrokenInvariant(AssertionError):
    """A state that cannot be."""


@runtime_checkable
class Checked(Protocol):
    """A core that can check its own state."""

    def validate(self) -> None:
        """Raises BrokenInvariant."""


def require(is_so: bool, what: str) -> None:
    """Raises BrokenInvariant unless it is so."""
    if not is_so:
        raise BrokenInvariant(what)
