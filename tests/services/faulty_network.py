"""A network that loses messages and processes: the cores of a run under every fault, without a clock or a socket.

What it has of the real one: a process that joins receives nothing that was sent before; messages of one sender keep
their order, those of different senders do not; an operator sends the start of its run until the store knows it.
"""

from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.metrics.store import Store
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Event, Membership, Rewind, Tick
from cogradar.shared.protocol.messages import Message, Refused, RunStart
from cogradar.shared.protocol.slots import may_be_said, slots_of
from cogradar.shared.protocol.topics import BY_MESSAGE, Role, is_for
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.wire.epochs import Epochs, Stamp
from cogradar.shared.wire.runner import TICK_S, Core, Deferring, Leading, Preparing

Item = tuple[bytes, Stamp | None] | Membership | Tick


@dataclass
class Process:
    """A core, what waits for it, and what it sent."""

    role: Role
    core: Core | None
    queues: dict[str, deque[Item]] = field(default_factory=lambda: defaultdict(deque))  # per sender
    sent: list[Message] = field(default_factory=list)
    epochs: Epochs = field(default_factory=Epochs)
    frozen: bool = False
    hung: bool = False  # alive for the others, and does nothing
    busy: bool = False  # something always waits for it
    cut_off: bool = False  # it goes on, but nothing that it sends arrives, and nothing reaches it

    @property
    def waiting(self) -> list[str]:
        return [sender for sender, queue in self.queues.items() if queue and not (self.frozen or self.hung)]


def _has_deferred(core: object) -> bool:
    return isinstance(core, Deferring) and core.has_deferred


class FaultyNetwork:
    """One run's processes; `loss` is the probability that a message is lost on its way to one reader."""

    def __init__(
        self,
        start: RunStart,
        planners: int,
        rng: np.random.Generator,
        loss: float = 0.0,
        journal: Journal | None = None,
    ) -> None:
        self.store = Store(journal or Journal(":memory:"))
        self.processes: dict[str, Process] = {}
        self.refused: list[str] = []
        self._start, self._rng, self._loss, self._time, self._recorder_began = start, rng, loss, 0.0, False
        self.start("recorder-0")
        for name in ("emulator-0", "allocator-0", *(f"planner-{i}" for i in range(planners))):
            self.start(name)
        self.processes["operator"] = Process(Role.OPERATOR, None)
        self.publish("operator", start)

    def start(self, name: str) -> None:
        """Start a process, or start it again: it knows nothing."""
        role = Role(name.split("-", maxsplit=1)[0])
        core = self._core(role, name)
        self.processes[name] = Process(role, core)
        self._tell_members(role)
        if isinstance(core, Leading):
            for message in core.lead():
                self.publish(name, message)

    def kill(self, name: str) -> None:
        """Kill a process: what it knew, what waited for it and what it had not committed is gone."""
        role = self.processes.pop(name).role
        if role is Role.RECORDER:
            self.store.journal.rollback()
        self._tell_members(role)

    def scores(self) -> list[dict[str, object]]:
        """How the run has been scored."""
        self.store.derive()
        return self.store.read("SELECT * FROM score ORDER BY t, target")

    def freeze(self, name: str) -> None:
        """Stop a process; the others think it dead."""
        self.processes[name].frozen = True
        self._tell_members(self.processes[name].role)

    def thaw(self, name: str) -> None:
        """Let it go on where it was."""
        self.processes[name].frozen = False
        self._tell_members(self.processes[name].role)

    def hang(self, name: str) -> None:
        """Let a process do nothing any more; the others think it alive."""
        self.processes[name].hung = True

    def step(self) -> bool:
        """Let some process handle the oldest message of some sender; false if nothing waits anywhere."""
        has_ticked = self._tick_deferring()
        busy = [name for name, process in self.processes.items() if process.waiting]
        if not busy:
            return has_ticked
        self._prepare()
        name = busy[self._rng.integers(len(busy))]
        process = self.processes[name]
        item = process.queues[process.waiting[self._rng.integers(len(process.waiting))]].popleft()
        if isinstance(item, tuple):
            self._open(name, *item)
        else:
            self._handle(name, item)
        return True

    def _open(self, name: str, payload: bytes, stamp: Stamp | None) -> None:
        """Let a process handle a message that it may heed."""
        message, epochs = decode(payload), self.processes[name].epochs
        if epochs.voids(message):
            self._handle(name, Rewind(message.run))
        if not epochs.fault(message, stamp):
            self._handle(name, message)

    def _tick_deferring(self) -> bool:
        """Let those handle a tick who have put something off until nothing waits; whether there are any."""
        ready = [
            name
            for name, process in self.processes.items()
            if not (process.waiting or process.frozen or process.hung or process.busy) and _has_deferred(process.core)
        ]
        for name in ready:
            self._handle(name, Tick(self._time))
        return bool(ready)

    def _prepare(self) -> None:
        """Let some process prepare, as it does while nothing waits for it."""
        cores = [process.core for process in self.processes.values() if not process.frozen]
        core: object = cores[self._rng.integers(len(cores))]
        if isinstance(core, Preparing):
            core.prepare()

    def tick(self) -> None:
        """A moment passes."""
        self._time += TICK_S
        if "operator" in self.processes and not self.store.read("SELECT 1 FROM run"):
            self.publish("operator", self._start)
        for name in [name for name, process in self.processes.items() if not (process.frozen or process.hung)]:
            self._handle(name, Tick(self._time, drained=not self.processes[name].busy))

    def _handle(self, name: str, event: Event) -> None:
        core = self.processes[name].core
        if core is None:
            return
        try:
            answers = core.handle(event)
        except Refused as refusal:
            self.refused.append(str(refusal))
            return
        for message in answers:
            if isinstance(message, Message):
                self.publish(name, message)

    def publish(self, sender: str, message: Message) -> None:
        """Let a process send a message; each reader may lose it."""
        topic, payload = BY_MESSAGE[type(message)], encode(message)
        if self.processes[sender].role is Role.PLANNER:
            assert may_be_said(message, slots_of(sender)), message  # else every reader would drop it
        self.processes[sender].sent.append(message)
        stamp = self.processes[sender].epochs.say(message)
        for name, process in self.processes.items():
            if not is_for(message, process.role, name):
                continue
            is_cut = process.cut_off or self.processes[sender].cut_off
            if process.role in topic.readers and not is_cut and self._rng.random() >= self._loss:
                process.queues[sender].append((payload, stamp))

    def _tell_members(self, role: Role) -> None:
        planners = {n: p for n, p in self.processes.items() if p.role is Role.PLANNER}
        alive = tuple(sorted(name for name, process in planners.items() if not process.frozen))
        for process in planners.values() if role is Role.PLANNER else ():
            process.queues["liveliness"].append(Membership(Role.PLANNER, alive))

    def _core(self, role: Role, name: str) -> Core:
        cores: dict[Role, Callable[[], Core]] = {
            Role.EMULATOR: lambda: EmulatorCore(SimulatedFrontEnd.open),
            Role.ALLOCATOR: AllocatorCore,
            Role.PLANNER: lambda: PlannerCore(name),
            Role.RECORDER: lambda: Recorder(self.store.journal, resume=self._recorder_began),
        }
        core = cores[role]()
        self._recorder_began |= role is Role.RECORDER
        return core


def play(network: FaultyNetwork, faults: dict[int, Callable[[], None]], patience: int = 200) -> str:
    """Let the run go on to its end, with a fault before each of these steps; its digest.

    A step is a message handled; when nothing moves time passes instead, and the faults to come are not waited for.
    `patience` is the number of ticks without a new message in the store.
    """
    steps = idle = stored = 0
    while True:
        (row,) = network.store.read("SELECT status, digest FROM run") or [{"status": "running", "digest": ""}]
        if row["status"] != "running" and not faults:
            return str(row["digest"])
        if steps in faults:
            faults.pop(steps)()
        if network.step():
            steps += 1
            continue
        network.tick()
        (now,) = network.store.read("SELECT COUNT(*) AS n FROM message")
        steps, idle, stored = min(faults, default=steps), 0 if now["n"] > stored else idle + 1, now["n"]
        assert idle < patience, "standstill"
