"""What a planner asks to be recalled, and when it asks again."""

from collections.abc import Sequence

from shared.protocol.recovery import ScanRecall


class RecallRequest:
    """One request at a time. It is not repeated when its answer does not help, or two planners would go on asking as
    fast as they are answered: a dwell that never was, in real time, is in no answer. A checkpoint lets them ask again.
    """

    def __init__(self, run: str, planner: str) -> None:
        self._run, self._planner = run, planner
        self._k = 0
        self._targets: set[int] = set()

    def ask(self, k: int, targets: Sequence[int], *, again: bool) -> list[ScanRecall]:
        """Request what these tracks lack from dwell k on, unless that was the last request; `again`: in any case."""
        if not again and self._k == k and self._targets.issuperset(targets):
            return []
        self._k, self._targets = k, set(targets)
        return [ScanRecall(run=self._run, k=k, targets=list(targets), planner=self._planner)]
