"""The processes of a system in simulated time: the real cores, the network between them, and one queue of events.

It stands in for what is not simulated: the main loop (`cogradar.shared.wire.runner.serve`), the transport, liveliness
tokens, and the supervisor that restarts processes.
"""

import heapq
import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from functools import partial

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.errors import BadInput, Deposed, StoreFailed
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Retention
from cogradar.services.simulation.checks.runs import Told, Violated
from cogradar.services.simulation.disk import Disk, PowerCut
from cogradar.services.simulation.front_end import ReceiverFaults, Watch, WatchedFrontEnd
from cogradar.services.simulation.network.links import LIVELINESS, Links
from cogradar.services.simulation.network.tokens import SeenTokens, TokenSpace
from cogradar.services.simulation.process import SPIN, Arrived, Clock, Process
from cogradar.shared.protocol.events import Event, Membership, Rewind, Shards, Tick
from cogradar.shared.protocol.messages import Checkpoint, Command, Message, Plan, Refused, RunStart
from cogradar.shared.protocol.recovery import History
from cogradar.shared.protocol.topics import ALL_SHARDS, BY_MESSAGE, Role, shard_of
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.wire.pool.members import Pool
from cogradar.shared.wire.runner import TICK_S, Core, Leading, Sharing

RESTART_S = 0.5  # after which a process that ended by itself is started again
ASK_TICKS = 8  # of the operator, between two starts of a run of which it hears nothing


class Spinning(Exception):
    """A process that never comes to rest."""


class Asking:
    """An operator that asks for its runs until they are over, whenever it hears nothing of them, and for its commands
    at each tick.
    """

    def __init__(self, starts: Sequence[RunStart], commands: Sequence[Command]) -> None:
        self.commands = list(commands)
        self._open = {start.run: start for start in starts}
        self._unheard = {start.run: ASK_TICKS - 1 for start in starts}  # ticks since a checkpoint

    def handle(self, event: Event) -> Sequence[Message]:
        """Ask again."""
        match event:
            case Checkpoint(ended=True):
                self._open.pop(event.run, None)
            case Checkpoint():
                self._unheard[event.run] = 0
            case Tick():
                for run in self._open:
                    self._unheard[run] += 1
                starts = [start for run, start in self._open.items() if self._unheard[run] % ASK_TICKS == 0]
                return [*starts, *filter(self.is_open, self.commands)]
            case _:
                pass
        return ()

    def is_open(self, command: Command) -> bool:
        """Whether its run is not over, as far as it has heard."""
        return command.run in self._open


# Something that happens at a time: when, a number that no other has, and what.
_Due = tuple[float, int, Callable[[], None]]


class Cluster:
    """Processes by their keys: a twin's key is not its name."""

    def __init__(
        self,
        seed: int,
        disk: Disk,
        watch: Watch = lambda *_: None,
        *,
        prepares: bool = False,
        keep: Retention | None = None,
        has_pools: bool = False,
    ) -> None:
        """Nothing is there yet.

        prepares  : processes prepare for what comes next while they are idle
        has_pools : emulators and allocators share the runs
        """
        self.now_s = 0.0
        self.processes: dict[str, Process] = {}
        self.links = Links(seed)
        self.tokens = TokenSpace(self.at, lambda: self.now_s, self.links)
        self._has_pools = has_pools
        self.refused: list[str] = []
        self.counts: Counter[str] = Counter()
        self.disk = disk
        self.receiver_faults = ReceiverFaults()
        self.told = Told()
        self._watch, self._prepares, self._keep = watch, prepares, keep
        self._due: list[_Due] = []
        self._n = itertools.count()
        self._recorder_began = False
        self._away: Counter[str] = Counter()  # by key: how often the runs of a process are elsewhere
        self.said: dict[bytes, Message] = {}  # by what it is on the wire
        # Who sent a plan of a run's dwell and track, and when first, once targets are followed.
        self.planned: defaultdict[tuple[str, int, int], dict[str, float]] = defaultdict(dict)

    def at(self, at_s: float, do: Callable[[], None]) -> None:
        """Let something happen then."""
        heapq.heappush(self._due, (at_s, next(self._n), do))

    def step(self, until_s: float) -> bool:
        """Let the next thing happen; false if nothing does until then."""
        if not self._due or self._due[0][0] > until_s:
            return False
        self.now_s, _, do = heapq.heappop(self._due)
        do()
        return True

    def ask(self, starts: Sequence[RunStart], commands: Sequence[Command] = ()) -> None:
        """Start an operator that begins these runs, at once, and commands them."""
        self._add("operator", "operator", Role.OPERATOR, Asking(starts, commands))
        self._handle(self.processes["operator"], Tick(0.0))

    def command(self, command: Command) -> None:
        """Let the operator ask for one more command, now and at each tick."""
        operator = self.processes["operator"]
        if isinstance(operator.core, Asking) and operator.core.is_open(command):
            operator.core.commands.append(command)
            self.publish(operator, command)

    def start(self, key: str, name: str = "") -> None:
        """Start a process, which knows nothing; it is called as its key if it has no other name."""
        role = Role(key.split("-", maxsplit=1)[0])
        try:
            self._add(key, name or key, role, self._core(role, name or key))
        except (PowerCut, StoreFailed) as error:
            self._died(key, error)
        except BadInput as error:  # it is no store any more: its process ends, and says so
            self.disk.refused = str(error)

    def kill(self, key: str, *, torn: bool = False) -> None:
        """Kill a process: what it knew, what waited for it and what it had not committed is gone."""
        process = self.processes.pop(key, None)
        if process is None:
            return
        self.tokens.leave(key)
        if process.role is Role.RECORDER and process.is_left:
            self.disk.discard_left(key)
        elif process.role is Role.RECORDER:
            self.disk.crash(torn=torn)
        self.tell_members()

    def succeed(self, key: str) -> None:
        """Start another process in the place of one that is frozen, which stays under another key."""
        process = self.processes.pop(key)
        process.is_left, process.checked = True, None  # the journal goes on without it
        left = f"{key}.left{self.disk.opened}"
        self.processes[left] = process
        self.disk.leave(left)
        self.start(key)

    def move(self, key: str, *, away: bool) -> None:
        """The runs of a process are elsewhere from now on, or here again; also of one that is started meanwhile."""
        self._away[key] += 1 if away else -1
        if key in self.processes:
            self._tell_shards(self.processes[key], key)

    def _tell_shards(self, process: Process, key: str) -> None:
        process.inbox.append(Shards(frozenset() if self._away[key] else ALL_SHARDS))
        self.serve(process)

    def tell_members(self) -> None:
        """Tell planners and recorder of the planners, and processes of a pool of each other, as far as they can see."""
        for key, process in self.processes.items():
            self.tokens.freeze(key, is_asleep=process.is_dead_to_others)
        self.tokens.tell()
        planners = [process for process in self.processes.values() if process.role is Role.PLANNER]
        for reader in [process for process in self.processes.values() if process.role in {Role.PLANNER, Role.RECORDER}]:
            seen = [one for one in planners if not one.is_dead_to_others and not self._is_cut(one, reader)]
            names = tuple(sorted({one.name for one in seen}))
            if names != reader.told:
                reader.told = names
                for at_s in self.links.arrivals(LIVELINESS, reader.name, self.now_s):
                    self.at(at_s, partial(self._put, reader, Membership(Role.PLANNER, names)))

    def publish(self, sender: Process, message: Message) -> None:
        """Send a message to all its readers."""
        self._check_serves(sender, message)
        topic, payload = BY_MESSAGE[type(message)], encode(message)
        item = Arrived(payload, sender.epochs.say(message))
        if isinstance(message, History) and not self.said.keys() >= set(message.payloads):
            raise Violated(f"{sender.name} recalls a {message.topic} of {message.run} that was never sent")
        to = getattr(message, "to", None)
        self.said[payload] = message
        if isinstance(message, Plan) and message.t > 0:
            self.planned[message.run, message.k, message.target].setdefault(sender.name, self.now_s)
        for reader in self.processes.values():
            if reader is not sender and reader.role in topic.readers and to in {None, reader.name, reader.role.value}:
                self.counts["sent"] += 1
                arrivals = self.links.arrivals(sender.name, reader.name, self.now_s)
                self.counts["lost"] += not arrivals
                self.counts["again"] += max(len(arrivals) - 1, 0)
                for at_s in arrivals:
                    self.at(at_s, partial(self._put, reader, item))

    def _check_serves(self, sender: Process, message: Message) -> None:
        """Raises Violated if another process serves the run of what one sends, and each can know of the other."""
        if sender.pool is None or not self.tokens.is_whole():
            return
        for other in self.processes.values():
            is_rival = other is not sender and other.role is sender.role and not other.halted
            if is_rival and shard_of(message.run) in other.holds:
                what = f"{sender.name} sends a {BY_MESSAGE[type(message)].name} of {message.run}"
                raise Violated(f"{what}, which {other.name} serves")

    def check_shares(self) -> None:
        """Each run is served by one process of each pool. Raises Violated."""
        for role in (Role.EMULATOR, Role.ALLOCATOR):
            there = [one for one in self.processes.values() if one.role is role and not one.halted]
            held = Counter(shard for one in there for shard in one.holds)
            if wrong := {shard: held[shard] for shard in sorted(ALL_SHARDS) if held[shard] != 1}:
                raise Violated(f"shards, and how many processes of role {role.value} serve each: {wrong}")

    def serve(self, process: Process) -> None:
        """Let a process handle what there is for it now."""
        for _ in range(SPIN):
            if not self._is_there(process) or not process.is_free(self.now_s):
                break
            if process.pool is not None and (held := process.pool.news()) is not None:
                process.holds = held
                self._handle(process, Shards(held))
            elif process.inbox:
                item = process.inbox.popleft()
                self._receive(process, item)
            elif not process.wants_tick(process.clock.read(self.now_s)):
                break
            if self._is_there(process) and process.wants_tick(reading_s := process.clock.read(self.now_s)):
                self._handle(process, process.tick(reading_s))
        else:
            raise Spinning(f"{process.name} does not come to rest")
        self._set_timer(process)

    def _receive(self, process: Process, item: Arrived | Membership | Shards) -> None:
        event: Event
        if isinstance(item, Arrived):
            event = decode(item.payload)
            if process.epochs.voids(event):
                self._handle(process, Rewind(event.run))
            if process.epochs.fault(event, item.stamp):
                self.counts["deposed"] += 1
                return
        else:
            event = item
        if isinstance(event, Checkpoint):
            self.told.hear(event, self.disk.journal if self.disk.is_open else None)
            if process.role is Role.EMULATOR:
                self.told.hear_orders(event)
        self._handle(process, event)

    def _set_timer(self, process: Process) -> None:
        """Look after a process when it must get a tick, or has time again."""
        if process.halted or not self._is_there(process):
            return
        if self._prepares and process.preparing is not None and not process.inbox:
            process.preparing.prepare()
        at_s = max(process.clock.when(process.wake_s(), self.now_s), process.busy_until_s)
        if process.timer_s is None or process.timer_s > at_s or process.timer_s < self.now_s:
            process.timer_s = at_s
            self.at(at_s, lambda: self._wake(process, at_s))

    def _wake(self, process: Process, at_s: float) -> None:
        if process.timer_s == at_s:
            process.timer_s = None
            self.serve(process)

    def _handle(self, process: Process, event: Event) -> None:
        self.counts["handled"] += isinstance(event, Message)
        try:
            for answer in process.core.handle(event):
                if isinstance(answer, Message):
                    self.publish(process, answer)
        except Refused as refusal:
            if not isinstance(event, Message):
                raise
            self.refused.append(f"{process.name}: {type(event).__name__}: {refusal}")
        except (PowerCut, StoreFailed, Deposed) as error:
            self._died(next(key for key, one in self.processes.items() if one is process), error)
            return
        if process.checked is not None:
            process.checked.validate()

    def _died(self, key: str, error: Exception) -> None:
        """A process has ended by itself; if the power was cut, the fault says when it comes back."""
        is_cut = isinstance(error, PowerCut)
        is_left = key in self.processes and self.processes[key].is_left  # another one is there already
        if key in self.processes:
            self.kill(key, torn=is_cut)
        else:
            self.disk.crash(torn=is_cut)
        if not is_cut and not is_left:
            self.at(self.now_s + RESTART_S, lambda: self.restart(key))

    def restart(self, key: str) -> None:
        """Start a process, unless it is there."""
        if key not in self.processes:
            self.start(key)

    def _put(self, process: Process, item: Arrived | Membership) -> None:
        if self._is_there(process):
            if not self._is_elsewhere(process.pool, item):
                process.inbox.append(item)
            self.serve(process)
        elif isinstance(item, Arrived):
            self.counts["dead"] += 1

    def _is_elsewhere(self, pool: Pool | None, item: Arrived | Membership) -> bool:
        """Whether a message is dropped by its key: it is of a run that is not served here."""
        return pool is not None and isinstance(item, Arrived) and shard_of(self.said[item.payload].run) not in pool.held

    def _add(self, key: str, name: str, role: Role, core: Core) -> None:
        process = self.processes[key] = Process(name, role, core, Clock(since_s=self.now_s))
        process.tick_s = TICK_S
        if self._has_pools and role in {Role.EMULATOR, Role.ALLOCATOR} and isinstance(core, Sharing):
            process.pool = Pool(SeenTokens(self.tokens, key, name, process.clock), lambda: core.busy)
            process.pool.begin()
        self.tell_members()
        if self._away[key]:
            self._tell_shards(process, key)
        if isinstance(core, Leading):
            for message in core.lead():
                self.publish(process, message)
        self._set_timer(process)

    def _is_there(self, process: Process) -> bool:
        return process in self.processes.values()

    def _is_cut(self, one: Process, reader: Process) -> bool:
        return one is not reader and self.links.is_cut(one.name, reader.name)

    def _core(self, role: Role, name: str) -> Core:
        match role:
            case Role.EMULATOR:
                return EmulatorCore(lambda checkpoint: WatchedFrontEnd(checkpoint, self._watch, self.receiver_faults))
            case Role.ALLOCATOR:
                return AllocatorCore()
            case Role.PLANNER:
                return PlannerCore(name, lambda: self.now_s)
            case Role.RECORDER:
                began, self._recorder_began = self._recorder_began, True
                journal = self.disk.open(self._wait)
                self.told.check(journal)
                return Recorder(journal, resume=began, keep=self._keep)
            case _:
                raise ValueError(f"{role} is not simulated")

    def _wait(self, seconds: float) -> None:
        """The recorder waits for its disk."""
        recorder = self.processes.get("recorder-0")
        if recorder is not None and seconds:
            recorder.busy_until_s = max(recorder.busy_until_s, self.now_s) + seconds
