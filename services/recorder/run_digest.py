"""The digest of a run, taken while the run goes on, so that at its end nobody waits for it."""

from services.recorder.journal import Store
from shared.wire.digest import DIGESTED, Digest

CATCH_UP_DWELLS = 16  # at a time, some 10 us each: how fast a metrics service that came back makes up for the past


class Traced:
    """The messages of dwells 0 .. k-1, in the order of dwell, topic and item, as they lie in the store."""

    def __init__(self, run: str) -> None:
        self._run = run
        self._k = 0
        self._trace = Digest(run)
        self._is_void = False

    def hear(self, k: int, topic: str) -> None:
        """A message is new in the store. One of a dwell that was taken already, as there may be in real time, comes
        too late: then all of them are taken at the end.
        """
        self._is_void |= k < self._k and topic in DIGESTED

    def go_on(self, store: Store, k: int) -> None:
        """Dwells up to k-1 are complete: take some of those that were not taken yet."""
        if not self._is_void:
            self._take(store, min(k, self._k + CATCH_UP_DWELLS))

    def digest(self, store: Store) -> str:
        """Of all that is in the store."""
        if self._is_void:
            self._k, self._trace = 0, Digest(self._run)
        self._take(store, None)
        return self._trace.hexdigest()

    def _take(self, store: Store, end: int | None) -> None:
        for payload in store.messages(self._run, DIGESTED, self._k, end):
            self._trace.add(payload)
        self._k = self._k if end is None else end
