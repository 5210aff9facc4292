"""A whole run in one process: the same cores on the local queue, every message still encoded and decoded."""

import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial

from cogradar.services.errors import Interrupted, RunFailed, check_stop
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.runs.dwell import DwellMessages
from cogradar.services.runs.oracle import Foresight, KnowingPlanner
from cogradar.services.runs.run import Progress, Result, ending, loaded, progress, result
from cogradar.services.topology import TOPOLOGY, Start
from cogradar.shared.protocol.events import Event
from cogradar.shared.protocol.messages import Plan, RunCancel, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.tables import TRUE_RULES
from cogradar.shared.wire.bus import Bus, LocalBus, LocalNetwork
from cogradar.shared.wire.runner import Closing, Core, step

REPORT_EVERY_S = 0.25


def play(
    start: RunStart,
    *,
    planners: int = 1,
    store: Store | None = None,
    report: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
    front_end: str = Start.front_end,
) -> Result:
    """Make one run to its end and score it; arguments and errors as of `steps`."""
    playing = steps(start, planners=planners, store=store, report=report, stop=stop, front_end=front_end)
    while True:
        try:
            next(playing)
        except StopIteration as ended:
            result: Result = ended.value
            return result


def steps(
    start: RunStart,
    *,
    planners: int = 1,
    store: Store | None = None,
    report: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
    front_end: str = Start.front_end,
) -> Generator[DwellMessages, Waveform | None, Result]:
    """Play one run dwell by dwell, the acquisition included, and score it at its end; closed earlier, it is stopped.

    A waveform that is sent in answer to a dwell is radiated next, in place of the one that the allocator made. Else the
    run is that of `play`.

    store     : where its messages go, and the scores are read
    front_end : a name of `cogradar.services.front_ends`

    Action-selection policies that know the truth can be played here only.

    Raises BadInput if it has no end, RunFailed if it does not reach it, Interrupted if `stop` is set meanwhile.
    """
    loaded(ending(start))
    began = next_report = time.monotonic()
    store = store or in_memory()
    network = LocalNetwork()
    endpoints = _endpoints(
        network, start, store, planners, Start("", front_end=front_end, check=partial(check_stop, stop))
    )
    ask = partial(answer, store)
    (recorded,) = (bus.queue for _, bus in endpoints if bus.role is Role.RECORDER)  # which gets all that is said

    def cancel() -> None:
        network.deliver(RunCancel(run=start.run))
        for core, bus in endpoints:
            if bus.role is Role.RECORDER:
                _take_turn(core, bus, None)

    network.deliver(start)
    dwells = _Dwells()
    with _ended_whatever_happens(store, cancel), _closed(core for core, _ in endpoints):
        while sum(_take_turn(core, bus, stop) for core, bus in endpoints):  # every core takes its turn
            for dwell in dwells.complete(recorded):
                if (chosen := (yield dwell)) is not None:
                    dwells.sent = chosen
                    for _, bus in endpoints:  # no core has read it: the allocator takes its turn last
                        _replace(bus.queue, dwell.next, chosen)
            if report is not None and time.monotonic() >= next_report:
                if (now := progress(ask, start)) is not None:
                    report(now)
                next_report = time.monotonic() + REPORT_EVERY_S
        done = result(ask, start, began)
        if done is None:
            progress(ask, start)  # raises if the run says itself why it failed
            raise RunFailed("the loop came to a standstill")
    return done


def _endpoints(
    network: LocalNetwork, start: RunStart, store: Store, planners: int, as_told: Start
) -> list[tuple[Core, LocalBus]]:
    """All cores of a run, in the order in which they take their turns."""
    knows_truth = start.scenario["radar"]["planner"]["rule"] in TRUE_RULES
    foresight = Foresight(start, as_told.front_end) if knows_truth else None
    endpoints = []
    for service in TOPOLOGY:
        for i in range(service.number(planners)):
            if service.core is not None and service.role is not Role.METRICS:  # we ask the store ourselves
                name = f"{service.role}-{i}"
                is_recorder = service.role is Role.RECORDER
                core = RecorderCore(store.journal) if is_recorder else service.core(replace(as_told, name=name))
                if foresight is not None and service.role is Role.PLANNER:
                    core = KnowingPlanner(core, foresight)
                endpoints.append((core, network.endpoint(service.role, name)))
    return endpoints


class _Dwells:
    """Messages by the dwell that they are of, until the waveform that follows from it is there."""

    def __init__(self) -> None:
        self._open: dict[int, DwellMessages] = {}
        self.sent: Waveform | None = None  # the newest

    def complete(self, messages: Iterable[Event]) -> Iterator[DwellMessages]:
        """Take what was said since the last time; the dwells of which nothing more will come."""
        for message in list(messages):
            match message:
                case Scan(k=k):
                    self._open[k] = DwellMessages(k, message, self.sent)
                case Truth(k=k):
                    self._open[k].truth = message
                case Plan(k=k):
                    self._open[k].plans.append(message)
                case Waveform(k=k):
                    self.sent = message
                    if (done := self._open.pop(k, None)) is not None:
                        done.next = message
                        yield done


@contextmanager
def _ended_whatever_happens(store: Store, cancel: Callable[[], None]) -> Iterator[None]:
    """The store does not say afterwards that its run goes on."""
    try:
        yield
    except (Interrupted, GeneratorExit):
        cancel()
        raise
    except BaseException:  # Ctrl-C as well
        with suppress(Exception):  # what happened first is what is told; the recorder may be of no use any more
            store.journal.rollback()
            store.journal.give_up_unfinished()
            store.journal.commit()
        raise


@contextmanager
def _closed(cores: Iterable[Core]) -> Iterator[None]:
    """A receiver that a run has switched on is off after it."""
    try:
        yield
    finally:
        for core in cores:
            if isinstance(core, Closing):
                core.close()


def _replace(queue: deque[Event], old: Event | None, new: Event) -> None:
    for i, event in enumerate(queue):
        if event is old:
            queue[i] = new


def _take_turn(core: Core, bus: Bus, stop: threading.Event | None) -> bool:
    """Let a core handle all that waits for it, so that no queue grows over a run; false if there was nothing."""
    busy = False
    while step(core, bus, 0.0):
        busy = True
        check_stop(stop)
    return busy
