"""What a planner asks to be recalled, and when it asks again."""

from collections.abc import Sequence

from shared.protocol.recovery import ScanRecall


class RecallRequest:
    """One open request at a time: the next one waits for its answers, which may come one by one and may be lost."""

    def __init__(self, run: str) -> None:
        self._run = run
        self._k = 0
        self._awaited: set[int] = set()  # targets for which no answer has come

    def ask(self, k: int, targets: Sequence[int], *, again: bool) -> list[ScanRecall]:
        """Request what these tracks lack from dwell k on, unless that is under way; `again`: in any case."""
        is_under_way = self._awaited.issuperset(targets) and self._k == k
        if is_under_way and not again:
            return []
        self._k, self._awaited = k, set(targets)
        return [ScanRecall(run=self._run, k=k, targets=list(targets))]

    def receive_snapshot(self, target: int, k: int) -> None:
        """A snapshot of this track has come, of the dwell asked for or later. Answers go to everybody who asks."""
        if k >= self._k:
            self._awaited.discard(target)

    def receive_scans(self, k: int) -> None:
        """Scans from dwell k on have come. They are the last part of an answer."""
        if k == self._k:
            self._awaited.clear()
