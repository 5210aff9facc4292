"""Which processes of a role are alive, from their liveliness tokens."""

import math
from collections.abc import Iterable

LEASE_S = 2.0  # after which the token of a silent process is gone
LEAVE_AFTER_S = 0.25 * LEASE_S  # without a token; one that comes back sooner was hidden by a hiccup of the link
RETURN_S = 1.5 * LEASE_S  # a restart of the router hides all tokens for up to 2.8 s from early ones


class LiveNames:
    """Names of live processes; a name whose token comes back in time never left."""

    def __init__(self, names: Iterable[str] = ()) -> None:
        self._names = set(names)
        self.absent: dict[str, float] = {}  # members without a token, and since when
        self._settled_s = -math.inf  # until then others may still be coming back to the router

    @property
    def names(self) -> tuple[str, ...]:
        """All members, in order."""
        return tuple(sorted(self._names))

    @property
    def due_s(self) -> float:
        """When `expire` may remove a name next; infinity if all tokens are there."""
        return max(min(self.absent.values(), default=math.inf) + LEAVE_AFTER_S, self._settled_s)

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

    def forget(self, name: str) -> None:
        """A member is no more, whatever is known of its token."""
        self._names.discard(name)
        self.absent.pop(name, None)

    def expire(self, now_s: float, *, is_connected: bool) -> bool:
        """Remove names that were absent for too long; none while this process itself has no router. Whether any was."""
        if not is_connected:
            self._settled_s = now_s + RETURN_S
        is_settled = now_s >= self._settled_s
        expired = {name for name, since in self.absent.items() if is_settled and now_s - since >= LEAVE_AFTER_S}
        self._names -= expired
        self.absent = {name: since for name, since in self.absent.items() if name not in expired}
        return bool(expired)
