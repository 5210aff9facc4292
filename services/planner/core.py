"""Planner worker: owns the belief of some (run, track)s, answers each scan with a plan.

Ownership is a hint, not a lock: two owners publish the same plan twice and the allocator takes one. A track is a
function of the scans, so a new owner rebuilds it: from the scans it has, else from those that it asks to be recalled,
which are those since the track's last snapshot.
"""

import itertools
import time
from collections.abc import Callable, Iterable

from services.delivery.inactivity import Inactivity
from services.delivery.pending import Pending
from services.planner.ownership import owners
from services.planner.run import PlannedRun
from shared.protocol.events import Event, Membership, Tick
from shared.protocol.messages import Checkpoint, Message, Refused, Scan
from shared.protocol.recovery import History
from shared.scenario.tables import BIN_RULES
from shared.wire.meter import Measures
from shared.wire.runner import Flush


class PlannerCore:
    """Scan k in, plan k out for each track this worker owns."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` limits the searches of runs in real time; in lockstep it is never read."""
        self._name = name
        self._clock = clock
        self._workers: tuple[str, ...] = (name,)
        self._runs: dict[str, PlannedRun] = {}
        self._pending = Pending()
        self._inactivity = Inactivity()

    @property
    def has_deferred(self) -> bool:
        """Whether a run in real time has scans that no track has observed."""
        return any(run.is_behind for run in self._runs.values())

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        """Receive a scan and plan; on a change of membership, take up the tracks that this worker now owns."""
        for run in self._inactivity.after(event):
            self._runs.pop(run, None)
        match event:
            case Checkpoint():
                return self._checkpoint(event)
            case Scan() if event.run in self._runs:
                return self._runs[event.run].receive(event)
            case Scan():
                self._pending.add(event)
            case History(topic="scan" | "snapshot") if event.run in self._runs:
                return self._runs[event.run].receive_history(event)
            case Membership():
                self._workers = tuple(sorted({*event.names, self._name}))
                return [answer for name in self._runs for answer in self._own(name)]
            case Tick():
                return itertools.chain.from_iterable(run.catch_up() for run in self._runs.values() if run.is_behind)
            case _:
                pass
        return ()

    def prepare(self) -> bool:
        """Predict one track while no scan waits."""
        return any(run.prepare() for run in self._runs.values())

    def measures(self) -> Measures:
        """How many tracks this worker owns."""
        return {"tracks_owned": sum(run.n_owned for run in self._runs.values())}

    def _checkpoint(self, checkpoint: Checkpoint) -> Iterable[Message | Flush]:
        """Begin a run, note how far it is acknowledged, or forget it.

        A checkpoint below the one before says that the journal lost its end, in a power cut. Dwells will be played
        again whose messages are forgotten here: the run begins anew, as it does for a worker that joins late.
        """
        name, rule = checkpoint.run, checkpoint.radar["planner"]["rule"]
        if rule not in BIN_RULES:
            raise Refused(f"radar.planner.rule = {rule}: needs the truth, which no planner is told")
        if checkpoint.ended:
            self._runs.pop(name, None)
            self._pending.forget(name)
            return ()
        if name in self._runs and not self._runs[name].is_rewound_by(checkpoint):
            return self._runs[name].acknowledge(checkpoint)
        self._runs[name] = PlannedRun(checkpoint, self._clock)
        return [*self._own(name), *self._pending.replay(name, self.handle)]

    def _own(self, name: str) -> Iterable[Message | Flush]:
        run = self._runs[name]
        workers = owners(name, run.radar.tracks, self._workers)
        return run.own(m for m, worker in enumerate(workers) if worker == self._name)
