"""What a planner asks to be recalled, and when it asks again."""

from collections.abc import Sequence

from shared.protocol.messages import Checkpoint
from shared.protocol.recovery import ScanRecall

PATIENCE = 3  # checkpoints, one each second of a run that stands still


class RecallRequest:
    """One request at a time. It is not repeated when its answer does not help, or two planners would go on asking as
    fast as they are answered: a dwell that never was, in real time, is in no answer. A checkpoint lets them ask again.

    A worker that joins a run waits for what others offer: with it come snapshots, from which there is little to replay.
    """

    def __init__(self, run: str, planner: str, *, is_joining: bool) -> None:
        self._run, self._planner = run, planner
        self._patience = PATIENCE if is_joining else 0
        self._k = 0
        self._targets: set[int] = set()

    def hear(self, checkpoint: Checkpoint) -> None:
        """Wait no longer when there was no offer for a while, or when the run waits, maybe for these tracks."""
        self._patience = 0 if checkpoint.resend else max(0, self._patience - 1)

    def wait_no_longer(self) -> None:
        """There is an offer, or nobody who could make one."""
        self._patience = 0

    def ask(self, k: int, targets: Sequence[int], *, again: bool) -> list[ScanRecall]:
        """Request what these tracks lack from dwell k on, unless that was the last request; `again`: in any case."""
        if self._patience or (not again and self._k == k and self._targets.issuperset(targets)):
            return []
        self._k, self._targets = k, set(targets)
        return [ScanRecall(run=self._run, k=k, targets=list(targets), planner=self._planner)]
