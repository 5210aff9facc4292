"""The way of a message from one process to another: how long it takes, and what may happen to it."""

from collections.abc import Iterable

import numpy as np

from cogradar.services.simulation.schedule import LINKS, SCHEDULE, Fault, Kind
from cogradar.shared.numerics.seeds import Purpose, generator

FASTEST_S, MEAN_S = 2e-4, 5e-4  # of a message that nothing happens to; the mean is what may be added
OVERTAKEN_S = 0.02  # mean of how long a message is held back that others overtake
_AT_ONCE = 1024
LIVELINESS = "liveliness"  # what tells of tokens, as the name of a sender


class Links:
    """All links between processes; messages of one sender to one reader keep their order unless a fault says else."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._rng = generator(seed, Purpose.FAULT, SCHEDULE, 1)
        self._drawn: list[float] = []
        self._last: dict[tuple[str, str], float] = {}  # when the newest message of a link arrives
        self._faults: dict[Fault, np.random.Generator] = {}

    def begin(self, fault: Fault) -> None:
        """From now on a fault is there."""
        if fault.kind in LINKS:
            self._faults[fault] = generator(self._seed, Purpose.FAULT, fault.n, 0)

    def end(self, fault: Fault) -> None:
        """It is over."""
        self._faults.pop(fault, None)

    def is_cut(self, sender: str, reader: str) -> bool:
        """Whether nothing gets through."""
        return any(fault.kind is Kind.CUT for fault in self._of(sender, reader))

    def arrivals(self, sender: str, reader: str, now_s: float) -> list[float]:
        """When a message that is sent now arrives: once, never, or several times."""
        copies, is_late = [self._latency()], False
        for fault in self._of(sender, reader):
            rng = self._faults[fault]
            match fault.kind:
                case Kind.CUT | Kind.ROUTER:
                    return []
                case Kind.LOSS if rng.random() < fault.amount:
                    return []
                case Kind.DELAY:
                    copies[0] += float(rng.exponential(fault.amount))
                case Kind.TWICE if rng.random() < fault.amount:
                    copies.append(copies[0] + float(rng.exponential(OVERTAKEN_S)))
                case Kind.ORDER if rng.random() < fault.amount:
                    copies[0], is_late = copies[0] + float(rng.exponential(OVERTAKEN_S)), True
                case _:
                    pass
        link = sender, reader
        if not is_late:
            copies[0] = max(now_s + copies[0], self._last.get(link, 0.0)) - now_s
            self._last[link] = now_s + copies[0]
        return [now_s + latency for latency in copies]

    def _of(self, sender: str, reader: str) -> Iterable[Fault]:
        if not self._faults:
            return ()
        of_link = [fault for fault in self._faults if sender.startswith(fault.who) and reader.startswith(fault.whom)]
        # What is seen of tokens while there is no router is for others to say.
        return [fault for fault in of_link if sender != LIVELINESS or fault.kind is not Kind.ROUTER]

    def _latency(self) -> float:
        if not self._drawn:
            self._drawn = (FASTEST_S + self._rng.exponential(MEAN_S, _AT_ONCE)).tolist()
        return self._drawn.pop()
