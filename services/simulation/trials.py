"""Many schedules, one seed after the other, on all cores; what is done is kept, so that they can go on another day."""

import gc
import itertools
import json
import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

from cogradar.services.campaigns.pool import LocalPool
from cogradar.services.errors import BadInput, check_stop
from cogradar.services.simulation.memory import remembering
from cogradar.services.simulation.schedule import Schedule
from cogradar.services.simulation.simulator import Outcome, play
from cogradar.shared.protocol.build import build

AT_ONCE = 500  # schedules that a worker plays before it says what it found
REMEMBERED = 30_000  # results of a worker
COLLECTED = 100  # schedules after which garbage is collected
POLL_S = 0.5
logging.getLogger("cogradar").addHandler(logging.NullHandler())  # trouble is what is asked for here


@dataclass
class Tally:
    """What a number of schedules has come to."""

    first: int  # seed
    program: str
    done: dict[int, int] = field(default_factory=dict)  # schedules played, by the first seed of each lot
    failed: dict[int, str] = field(default_factory=dict)  # what is violated, by seed
    handled: int = 0  # messages
    faults: int = 0
    simulated_s: float = 0.0

    @property
    def n(self) -> int:
        """Schedules that were played."""
        return sum(self.done.values())

    def add(self, lot: "Tally") -> None:
        """Add what a worker has found."""
        self.done |= lot.done
        self.failed |= lot.failed
        self.handled, self.faults = self.handled + lot.handled, self.faults + lot.faults
        self.simulated_s += lot.simulated_s


def play_lot(first: int, n: int) -> Tally:
    """Play the schedules of these seeds."""
    tally = Tally(first, "")
    with remembering(REMEMBERED), _collecting_rarely() as collect:
        for seed in range(first, first + n):
            outcome = play(Schedule.draw(seed))
            _count(tally, outcome)
            collect()
    tally.done[first] = n
    return tally


def shrunk(seed: int) -> Outcome:
    """The schedule of a seed with as few faults as it takes to fail: those are left out that it fails without."""
    with remembering(REMEMBERED):
        outcome = play(Schedule.draw(seed))
        for fault in outcome.schedule.faults if outcome.violation else ():
            fewer = play(outcome.schedule.without(fault))
            outcome = fewer if fewer.violation else outcome
    return outcome


def play_all(
    first: int, n: int, *, workers: int, store: str | None, report: Callable[[Tally], None], stop: threading.Event
) -> Tally:
    """Play n schedules from a seed on, those that `store` has already excepted. Raises BadInput, Interrupted."""
    tally = _resumed(first, store)
    lots = _lots(first, n, tally)
    with LocalPool(workers).open(-(-n // AT_ONCE)) as pool:
        waiting: set[Future[Tally]] = set()
        while True:
            check_stop(stop, f"; {tally.n} of {n} schedules were run" + (", they are kept" if store else ""))
            while len(waiting) < workers and (lot := next(lots, None)) is not None:
                waiting.add(pool.submit(play_lot, *lot))
            if not waiting:
                return tally
            done, waiting = wait(waiting, POLL_S, FIRST_COMPLETED)
            for future in done:
                tally.add(future.result())
                _keep(tally, store)
                report(tally)


@contextmanager
def _collecting_rarely() -> Iterator[Callable[[], None]]:
    """To look through all that is remembered for garbage would take a third of the time: now and then is enough."""
    played = itertools.count(1)

    def collect() -> None:
        if next(played) % COLLECTED == 0:
            gc.unfreeze()
            gc.collect()
            gc.freeze()

    gc.disable()
    try:
        yield collect
    finally:
        gc.unfreeze()
        gc.enable()


def _count(tally: Tally, outcome: Outcome) -> None:
    tally.handled += outcome.handled
    tally.faults += len(outcome.schedule.faults)
    tally.simulated_s += outcome.simulated_s
    if outcome.violation:
        tally.failed[outcome.schedule.seed] = outcome.violation


def _lots(first: int, n: int, tally: Tally) -> Iterator[tuple[int, int]]:
    """First seed and number of those lots that were not played."""
    for start in range(first, first + n, AT_ONCE):
        size = min(AT_ONCE, first + n - start)
        if tally.done.get(start, 0) < size:
            yield start, size


def _resumed(first: int, store: str | None) -> Tally:
    if store is None or not Path(store).exists():
        return Tally(first, build())
    try:
        found = json.loads(Path(store).read_text(encoding="utf-8"))
        by_seed = {name: {int(seed): value for seed, value in found[name].items()} for name in ("done", "failed")}
        tally = Tally(**(found | by_seed))
    except (ValueError, TypeError, KeyError, AttributeError, OSError) as error:
        raise BadInput(f"{store}: no file of `simulate`: {' '.join(str(error).split())[:200]}") from None
    if (tally.first, tally.program) != (first, build()):
        raise BadInput(f"{store}: of seed {tally.first} or of another version of the program; name another file")
    return tally


def _keep(tally: Tally, store: str | None) -> None:
    if store is not None:
        fresh = Path(f"{store}.new")
        fresh.write_text(json.dumps(asdict(tally)), encoding="utf-8")
        fresh.replace(store)
