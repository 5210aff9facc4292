"""Which tracks of a run a worker plans for: those that it owns, and those that it leaves once their owner has them."""

import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

from cogradar.shared.protocol.messages import Checkpoint
from cogradar.shared.protocol.recovery import Handover

PATIENCE = 3  # requests for what is missing of a dwell, the later ones twice as long after each other
log = logging.getLogger(__name__)


def batches(tracks: Sequence[int]) -> Iterator[Sequence[int]]:
    """Half of the tracks, half of the rest, and so on.

    To wake the readers for every plan costs all of them more than to read it; but they should not have to read many
    once the last one is made.
    """
    while tracks:
        half = (len(tracks) + 1) // 2
        yield tracks[:half]
        tracks = tracks[half:]


class HeldTracks:
    """A worker that joins takes over without a pause: the old owner plans until the new one says that it does."""

    def __init__(self, run: str, planner: str) -> None:
        self.owned: tuple[int, ...] = ()
        self._leaving: tuple[int, ...] = ()
        self._offered_k = 0
        self._asked_k, self._n_asked = 0, 0  # dwell from which all is asked for again, and how often it was
        self._planned_k: dict[int, int] = {}  # of tracks taken over: up to this dwell their old owner has planned
        self._run, self._planner = run, planner

    @property
    def all(self) -> tuple[int, ...]:
        """Tracks that this worker plans for."""
        return self.owned + self._leaving

    def own(self, chosen: Iterable[int], current: Collection[int], *, quietly: bool) -> Collection[int]:
        """Own what is chosen; of those held before, leave the others that are up to date once somebody has them.

        Returns those to be left that were owned until now.
        """
        before, owned, self.owned = self.all, self.owned, tuple(chosen)
        now = set(self.owned)
        self._leaving = tuple(m for m in before if m in current and m not in now)
        self._planned_k = {m: k for m, k in self._planned_k.items() if m in now}
        if not quietly and before != self.all:
            log.info("%s: owns tracks %s", self._run, ", ".join(str(m + 1) for m in self.owned) or "none")
        return [m for m in self._leaving if m in owned]

    def offer(self, unsaved: Collection[int], next_k: Callable[[int], int]) -> Sequence[Handover]:
        """What another worker owns and this one plans for, and up to which dwell; `next_k` is a track's next one.

        With a snapshot under way the new owner has little to replay: those that are `unsaved` wait for it.
        """
        offered = [m for m in self._leaving if m not in unsaved]
        self._offered_k = min(map(next_k, offered), default=0) - 1
        return self._say(offered, self._offered_k, taken=False)

    def take(self, said: Handover, up_to_date: Collection[int]) -> Sequence[Handover]:
        """Of what another worker offers, take what is owned and as far here as there."""
        behind = [m for m in said.targets if m in self.owned and m not in up_to_date]
        self._planned_k |= dict.fromkeys(behind, said.k)
        return self._say([m for m in said.targets if m in self.owned and m in up_to_date], said.k, taken=True)

    def first_k(self, track: int) -> int:
        """The first dwell that is still to be planned for."""
        return self._planned_k.get(track, -1) + 1

    def plan_again(self, checkpoint: Checkpoint) -> Sequence[int]:
        """Tracks whose old owner had planned for dwells that are not complete: what it sent may be lost."""
        if checkpoint.k != self._asked_k:
            self._asked_k, self._n_asked = checkpoint.k, 0
        self._n_asked += checkpoint.resend
        if not checkpoint.resend or self._n_asked < PATIENCE:
            return []
        lost = [m for m, k in self._planned_k.items() if k >= checkpoint.k]
        for m in lost:
            del self._planned_k[m]
        return lost

    def leave(self, said: Handover) -> None:
        """Another worker has these tracks, unless it answers one that is not as far as this worker."""
        if said.k >= self._offered_k:
            self._leaving = tuple(m for m in self._leaving if m not in said.targets)

    def _say(self, targets: Sequence[int], k: int, *, taken: bool) -> Sequence[Handover]:
        if not targets or k < 0:
            return ()
        return (Handover(run=self._run, planner=self._planner, k=k, targets=list(targets), taken=taken),)
