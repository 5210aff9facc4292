"""What a planner asks to be recalled, and when it asks again."""

from collections.abc import Iterable, Sequence

from cogradar.shared.protocol.messages import Checkpoint
from cogradar.shared.protocol.recovery import ScanRecall

# Checkpoints; of a run that stands still there is one each second, else one each 16 dwells.
REPEAT = 3  # after which a request may be lost, or its answer


class RecallRequest:
    """One request at a time. It is not repeated when its answer does not help, or two planners would go on asking as
    fast as they are answered: a dwell that never was, in real time, is in no answer. It is when the recorder asks for
    something that is missing, or after some checkpoints.

    A worker that joins a run waits for what others offer: with it come snapshots, from which there is little to replay.
    """

    def __init__(self, run: str, planner: str, awaited: int) -> None:
        """`awaited`: checkpoints that it waits for offers."""
        self._run, self._planner = run, planner
        self._awaited, self._offered = awaited, set[int]()
        self._n_heard = 0  # checkpoints since the last request
        self._k = 0
        self._targets: set[int] = set()

    def hear(self, checkpoint: Checkpoint) -> None:
        """Note a checkpoint."""
        self._n_heard = REPEAT if checkpoint.resend else self._n_heard + 1
        self._awaited = 0 if checkpoint.resend else max(0, self._awaited - 1)

    def offer(self, targets: Iterable[int]) -> None:
        """Another worker offers these tracks."""
        if self._awaited:
            self._offered.update(targets)

    def wait_no_longer(self) -> None:
        """There may be no planner left that could offer what is lacking."""
        self._awaited = 0

    def may_ask(self, target: int) -> bool:
        """Whether the time has come to ask for what a track lacks."""
        return not self._awaited or target in self._offered

    def ask(self, k: int, targets: Sequence[int], *, goes_on: bool = False) -> list[ScanRecall]:
        """Request what these tracks lack from dwell k on. Meanwhile, if it `goes_on`, they are rebuilt from scans."""
        is_repeated = (goes_on or self._k == k) and self._targets.issuperset(targets)
        if is_repeated and self._n_heard < REPEAT:
            return []
        self._k, self._targets, self._n_heard = k, set(targets), 0
        return [ScanRecall(run=self._run, k=k, targets=list(targets), planner=self._planner)]
