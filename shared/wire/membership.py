"""Which processes of a role are alive, from their liveliness tokens."""

import math
from collections.abc import Iterable

LEAVE_AFTER_S = 3.0  # without a token; a restart of the router hides all tokens for up to 2.8 s


class LiveNames:
    """Names of live processes; a name whose token comes back in time never left."""

    def __init__(self, names: Iterable[str] = ()) -> None:
        self._names = set(names)
        self.absent: dict[str, float] = {}  # members without a token, and since when

    @property
    def names(self) -> tuple[str, ...]:
        """All members, in order."""
        return tuple(sorted(self._names))

    @property
    def due_s(self) -> float:
        """When `expire` may remove a name next; infinity if all tokens are there."""
        return min(self.absent.values(), default=math.inf) + LEAVE_AFTER_S

    def appear(self, name: str) -> bool:
        """A token is there. Returns whether the members changed."""
        self.absent.pop(name, None)
        is_new = name not in self._names
        self._names.add(name)
        return is_new

    def disappear(self, name: str, now_s: float) -> None:
        """A token is gone."""
        if name in self._names:
            self.absent[name] = now_s

    def expire(self, now_s: float, *, is_connected: bool) -> bool:
        """Remove who was absent for too long; nobody while this process itself has no router. Whether any was."""
        if not is_connected:
            self.absent = dict.fromkeys(self.absent, now_s)
        expired = {name for name, since in self.absent.items() if now_s - since >= LEAVE_AFTER_S}
        self._names -= expired
        self.absent = {name: since for name, since in self.absent.items() if name not in expired}
        return bool(expired)
