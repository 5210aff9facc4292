"""What a planner asks to be recalled, and when it asks again."""

from collections.abc import Sequence

from shared.protocol.messages import Checkpoint
from shared.protocol.recovery import ScanRecall

PATIENCE = 3  # checkpoints, one each second of a run that stands still


class RecallRequest:
    """One request at a time. It is not repeated when its answer does not help, or two planners would go on asking as
    fast as they are answered: a dwell that never was, in real time, is in no answer. It is when the recorder asks for
    something that is missing, or after some checkpoints: the request may be lost, or its answer.

    A worker that joins a run waits for what others offer: with it come snapshots, from which there is little to replay.
    """

    def __init__(self, run: str, planner: str, *, is_joining: bool) -> None:
        self._run, self._planner = run, planner
        self._awaits_offer = is_joining
        self._n_heard = 0  # checkpoints since the last request
        self._k = 0
        self._targets: set[int] = set()

    def hear(self, checkpoint: Checkpoint) -> None:
        """Note a checkpoint."""
        self._n_heard = PATIENCE if checkpoint.resend else self._n_heard + 1
        self._awaits_offer = self._awaits_offer and self._n_heard < PATIENCE

    def wait_no_longer(self) -> None:
        """There is an offer, or nobody who could make one."""
        self._awaits_offer = False

    def ask(self, k: int, targets: Sequence[int]) -> list[ScanRecall]:
        """Request what these tracks lack from dwell k on."""
        is_repeated = self._k == k and self._targets.issuperset(targets)
        if self._awaits_offer or (is_repeated and self._n_heard < PATIENCE):
            return []
        self._k, self._targets, self._n_heard = k, set(targets), 0
        return [ScanRecall(run=self._run, k=k, targets=list(targets), planner=self._planner)]
