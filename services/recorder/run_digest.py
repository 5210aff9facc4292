"""The digest of a run, taken while the run goes on, so that it is there at the end without a wait."""

from cogradar.services.recorder.journal import Journal, Unreadable
from cogradar.shared.wire.digest import DIGESTED, Digest

CATCH_UP_DWELLS = 16  # at a time, some 10 us each: how fast a recorder that came back makes up for the past


class RunDigest:
    """The messages of dwells 0 .. k-1, in the order of dwell, topic and item, as they lie in the journal."""

    def __init__(self, run: str) -> None:
        self._run = run
        self._k = 0
        self._digest = Digest(run)

    def advance(self, journal: Journal, k: int) -> None:
        """Dwells up to k-1 are complete: take some of those that were not taken yet. Raises Unreadable, Damaged."""
        self._take(journal, min(k, self._k + CATCH_UP_DWELLS))

    def finish(self, journal: Journal) -> str:
        """Of all that is in the journal. Raises Unreadable, Damaged."""
        self._take(journal, None)
        return self._digest.hexdigest()

    def _take(self, journal: Journal, end: int | None) -> None:
        for payload in journal.messages(self._run, DIGESTED, self._k, end):
            try:
                self._digest.add(payload)
            except ValueError as error:
                raise Unreadable(str(error)) from None
        self._k = self._k if end is None else end
