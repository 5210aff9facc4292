"""One schedule from its beginning to its end: the faults come and go, and then everything must come right."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial

from cogradar.services.delivery import pacing
from cogradar.services.emulator.front_end import Transmission
from cogradar.services.errors import Damaged
from cogradar.services.planner import owned_track
from cogradar.services.recorder import core
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal, order_of
from cogradar.services.recorder.store.check import check_row, check_run, damages
from cogradar.services.simulation.checks.real_time import check_real_time
from cogradar.services.simulation.checks.runs import (
    Dwell,
    Violated,
    check_journal,
    check_planned_once,
    check_power,
    check_waveforms,
    fingerprint,
)
from cogradar.services.simulation.cluster import Cluster
from cogradar.services.simulation.disk import Disk
from cogradar.services.simulation.process import Process
from cogradar.services.simulation.schedule import AHEAD_DWELLS, LEASE_S, LINKS, POOLS, Asked, Fault, Kind, Schedule
from cogradar.services.simulation.skies import starts_of
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import Checkpoint, Command
from cogradar.shared.protocol.orders import Order, PowerLimit
from cogradar.shared.protocol.topics import Role

WITHIN_S = 20.0  # of the end of the last fault, or of the last dwell of real time, all runs must be over
SETTLED_S = 15.0  # of the end of the last fault, or of the last dwell: all shards of a pool are shared again
NEVER = 10**6  # a dwell after the end of any run: a command for it is refused
STORM = 20_000  # messages handled, a hundred times as many as a run has
DISK, RECORDER = 2, "recorder-0"  # the disk's place among the generators of a schedule
MAX_AHEAD_DWELLS = pacing.MAX_AHEAD_DWELLS  # of a run without commands
_SWITCHED = {Kind.FULL, Kind.SLOW, Kind.RECEIVER, Kind.SUCCESSOR, Kind.BROKEN, Kind.REMOVED}  # on, and off again
Fingerprints = dict[str, tuple[object, ...]]


@dataclass(frozen=True)
class Outcome:
    """What became of a schedule."""

    schedule: Schedule
    violation: str = ""  # empty: all holds
    simulated_s: float = 0.0
    handled: int = 0  # messages
    found: Fingerprints | None = None  # of its runs, if they are over


def play(schedule: Schedule) -> Outcome:
    """Play a schedule: what is wrong with it is in the outcome. Only a fault of the simulator itself is raised."""
    disk = Disk(generator(schedule.seed, Purpose.FAULT, -1, DISK))
    try:
        with _often(schedule):
            return Simulator(schedule, disk).play()
    finally:
        disk.close()


@contextmanager
def _often(schedule: Schedule) -> Iterator[None]:
    """Checkpoints and snapshots as often as a schedule says, and effects of commands as soon, so that a short run has
    several.
    """
    before = core.CHECKPOINT_DWELLS, owned_track.SNAPSHOT_DWELLS, pacing.MAX_AHEAD_DWELLS
    core.CHECKPOINT_DWELLS, owned_track.SNAPSHOT_DWELLS = schedule.checkpoint_dwells, schedule.snapshot_dwells
    # Also where it stays what it is elsewhere: what a run is compared with is played within the play of that run.
    is_short = schedule.commands and not schedule.pacing.has_deadlines
    pacing.MAX_AHEAD_DWELLS = AHEAD_DWELLS if is_short else MAX_AHEAD_DWELLS
    try:
        yield
    finally:
        core.CHECKPOINT_DWELLS, owned_track.SNAPSHOT_DWELLS, pacing.MAX_AHEAD_DWELLS = before


@lru_cache(maxsize=256)
def undisturbed(schedule: Schedule) -> Fingerprints:
    """What the runs of a schedule in lockstep are when nothing happens: of these settings, whatever its seed."""
    outcome = play(schedule)
    if outcome.found is None:
        raise Violated(f"without any fault: {outcome.violation}")
    return outcome.found


class Simulator:
    """A schedule and its cluster."""

    def __init__(self, schedule: Schedule, disk: Disk) -> None:
        self._schedule, self._disk = schedule, disk
        self._starts = starts_of(schedule)
        self._commands = [
            Command(run=self._starts[one.run].run, id=f"{n:032x}", by="operator", action=one.action, at=one.at)
            for n, one in enumerate(schedule.commands)
        ]
        self._radiated: list[Dwell] = []
        self._put_back_s = 0.0  # when an older journal was put in place last
        self._down: dict[str, set[Fault]] = {name: set() for name in schedule.names}
        self._cluster = Cluster(
            schedule.seed, disk, self._watch, prepares=schedule.prepares, has_pools=schedule.pool > 1
        )

    def play(self) -> Outcome:
        """From the start of all processes to the end of all runs."""
        cluster, violation, found = self._cluster, "", None
        for name in self._schedule.names:
            cluster.start(name)
        if begins_s := self._schedule.begins_s:
            cluster.at(begins_s, self._ask)
        else:
            self._ask()
        for asked, command in zip(self._schedule.commands, self._commands, strict=True):
            if asked.asked_s:
                cluster.at(begins_s + asked.asked_s, partial(cluster.command, command))
        for fault in self._schedule.faults:
            cluster.at(fault.at_s, partial(self._begin, fault))
            if fault.until_s < math.inf:
                cluster.at(fault.until_s, partial(self._end, fault))
        try:
            self._let_run()
            found = self._check()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is found
            if not (self._schedule.is_rotten and isinstance(error, Damaged)):  # all is held, or cannot be read here
                violation = f"{type(error).__name__}: {error}"
        return Outcome(self._schedule, violation, cluster.now_s, cluster.counts["handled"], found)

    def _ask(self) -> None:
        """Start an operator, with the commands that are asked at once."""
        both = zip(self._schedule.commands, self._commands, strict=True)
        self._cluster.ask(self._starts, [command for asked, command in both if not asked.asked_s])

    def _let_run(self) -> None:
        """Until all runs are over, which must be soon after the last fault. Raises Violated."""
        cluster, playing_s = self._cluster, self._schedule.pacing.seconds(self._starts[0].dwells)
        quiet_s = max(self._schedule.quiet_s, self._schedule.begins_s)
        latest_s = quiet_s + playing_s + WITHIN_S
        checked_s = 0.0
        while cluster.step(latest_s):
            if cluster.counts["handled"] > STORM:
                raise Violated(f"a storm of messages, {STORM} by {cluster.now_s:.1f} s")
            if cluster.now_s >= max(quiet_s, checked_s + 0.05):
                checked_s = cluster.now_s
                if self._is_over():
                    self._settle()
                    return
        if not self._disk.is_open and not self._disk.refused:
            raise Violated(f"no recorder at {latest_s:.1f} s")
        if self._schedule.is_rotten and (self._disk.refused or self._is_held() or self._damaged()):
            return
        k = [dict(row) for row in self._journal.read("SELECT run, status, acknowledged_k AS k FROM run")]
        raise Violated(f"not over at {latest_s:.1f} s, the faults were at {quiet_s:.1f} s: {k}")

    def _settle(self) -> None:
        """Let pools share their shards again, also if no run is left that would show it. Raises Violated."""
        if self._schedule.pool > 1:
            while self._cluster.step(self._schedule.quiet_s + SETTLED_S):
                pass
            self._cluster.check_shares()

    def _is_over(self) -> bool:
        if RECORDER not in self._cluster.processes or any(one.is_left for one in self._cluster.processes.values()):
            return False
        rows = self._journal.rows("SELECT COUNT(*) FROM run WHERE status <> 'running'")
        return bool(rows[0][0] == len(self._starts)) and not self._journal.has_uncommitted

    def _is_held(self) -> bool:
        recorder = self._cluster.processes.get(RECORDER)
        return recorder is not None and isinstance(recorder.core, Recorder) and bool(recorder.core.trouble)

    def _damaged(self) -> set[str]:
        """Runs whose damage was noticed: a recorder has set them aside, or a reader finds it."""
        if not self._schedule.is_rotten:
            return set()
        if self._disk.refused or self._is_held():
            return {start.run for start in self._starts}
        there = {row[0] for row in self._journal.rows("SELECT run FROM run WHERE status <> 'quarantined'")}
        return {
            start.run
            for start in self._starts
            if start.run not in there or damages(check_run, self._journal, start.run)
        }

    @property
    def _journal(self) -> Journal:
        return self._disk.journal

    def _check(self) -> Fingerprints:
        """All that must hold at the end. Raises Violated."""
        schedule, said = self._schedule, self._cluster.said
        damaged = self._damaged()
        starts = [start for start in self._starts if start.run not in damaged]
        radiated = [dwell for dwell in self._radiated if dwell.run not in damaged]
        self._check_believed(damaged)
        given = {start.run: self._given(start.run) for start in starts}
        check_power(starts, radiated, given, self._put_back_s)
        if starts:
            check_journal(self._journal, starts, said)
        check_waveforms(starts, radiated, said.values())
        is_late = any(isinstance(message, Checkpoint) and message.overdue for message in said.values())
        if not is_late and all(fault.until_s < math.inf for fault in schedule.faults):
            check_planned_once(self._cluster.planned, schedule.quiet_s)
        if not schedule.faults and any(isinstance(message, Checkpoint) and message.resend for message in said.values()):
            raise Violated("nothing was lost, and something is asked for again")
        found = {start.run: fingerprint(self._journal, start.run) for start in starts}
        if schedule.pacing.has_deadlines:
            check_real_time(schedule, self._journal, starts, radiated, said.values())
        elif schedule.faults:
            _compare(found, undisturbed(schedule.plain(self._as_given(given))))
        return found

    def _check_believed(self, damaged: Collection[str]) -> None:
        """Runs whose damage a reader finds did not come to another end by it. Raises Violated."""
        for run in sorted(damaged) if not self._disk.refused else ():
            try:
                row, _ = check_row(self._journal, run), self._journal.stored("command", "WHERE run = ?", [run])
            except Damaged:  # it is in what says so
                continue
            given = {run: self._given(run)}
            _, _, expected, *_ = undisturbed(self._schedule.plain(self._as_given(given)))[run]
            if row["status"] == "complete" and row["digest"] != expected:
                raise Violated(f"{run}: its damage was believed: digest {row['digest']}, but undisturbed {expected}")

    def _given(self, run: str) -> list[Order | None]:
        """What became of the commands of a run, by number: an order, or None if it was refused."""
        rows = self._journal.read("SELECT n, k, action FROM command WHERE run = ? ORDER BY n", [run])
        return [None if row["k"] is None else order_of(row) for row in rows]

    def _as_given(self, given: Mapping[str, Sequence[Order | None]]) -> tuple[Asked, ...]:
        """The commands by which a run that nothing disturbs has the same orders: each at the dwell that it came to."""
        refused = Asked(0, PowerLimit(share=0.5), NEVER)
        return tuple(
            replace(refused, run=i) if order is None else Asked(i, order.action, order.k)
            for i, start in enumerate(self._starts)
            for order in given.get(start.run, ())
        )

    def _watch(self, run: str, k: int, t: int, waveform: Transmission, is_measured: bool) -> None:
        told = self._cluster.told
        self._radiated.append(Dwell.of(run, self._cluster.now_s, (k, t), waveform, told, is_measured=is_measured))
        if not self._schedule.pacing.has_deadlines:
            told.check_ahead(run, k, pacing.MAX_AHEAD_DWELLS)

    # Faults.

    def _begin(self, fault: Fault) -> None:
        cluster = self._cluster
        if fault.kind in LINKS | POOLS:
            cluster.links.begin(fault)
            cluster.tokens.begin(fault)
            cluster.tell_members()
            return
        process = cluster.processes.get(fault.who)
        match fault.kind:
            case Kind.CRASH | Kind.LEAVE | Kind.GONE:
                self._down[fault.who].add(fault)
                cluster.kill(fault.who)
            case Kind.POWER:
                self._disk.cuts_power = True
            case Kind.HANG | Kind.FREEZE if process is not None:
                process.halted.add(fault)
                if fault.kind is Kind.FREEZE:
                    cluster.at(cluster.now_s + LEASE_S, partial(self._expire, process, fault))
            case Kind.BEHIND if process is not None:
                process.behind.add(fault)
            case Kind.TWIN | Kind.MOVED:
                self._double(fault, is_there=True)
            case Kind.DRIFT if process is not None:
                process.clock.set(cluster.now_s, pace=fault.amount)
            case Kind.JUMP if process is not None:
                process.clock.set(cluster.now_s, pace=process.clock.pace, ahead_s=fault.amount)
            case _ if fault.kind in _SWITCHED:
                self._set(fault, is_there=True)
            case Kind.RESTORED | Kind.UNSYNCED:
                (self._disk.back_up if fault.kind is Kind.RESTORED else self._disk.lose_syncs)()
            case _:
                pass

    def _end(self, fault: Fault) -> None:
        cluster = self._cluster
        if fault.kind in LINKS | POOLS:
            cluster.links.end(fault)
            cluster.tokens.end(fault)
            cluster.tell_members()
            return
        process = cluster.processes.get(fault.who)
        match fault.kind:
            case Kind.CRASH:
                self._down[fault.who].discard(fault)
                self._start(fault.who)
            case Kind.LEAVE:
                cluster.start(f"{fault.who}.{fault.n}")
            case Kind.POWER:
                self._disk.cuts_power = False
                self._start(fault.who)
            case Kind.HANG | Kind.FREEZE:
                self._let_go(fault)
            case Kind.BEHIND if process is not None:
                process.behind.discard(fault)
            case Kind.TWIN | Kind.MOVED:
                self._double(fault, is_there=False)
            case Kind.DRIFT if process is not None:
                process.clock.set(cluster.now_s, pace=1.0)
            case _ if fault.kind in _SWITCHED:
                self._set(fault, is_there=False)
            case Kind.ROT:
                cluster.told.is_restored = True
                cluster.kill(fault.who)
                self._disk.rot()
                self._start(fault.who)
            case Kind.RESTORED | Kind.UNSYNCED:
                self._put_journal_back(fault)
            case _:
                pass

    def _put_journal_back(self, fault: Fault) -> None:
        """Let the recorder come back with an older journal."""
        cluster = self._cluster
        cluster.told.is_restored, self._put_back_s = True, cluster.now_s
        if fault.kind is Kind.UNSYNCED:  # without power no process of the machine goes on
            for key in [key for key, one in cluster.processes.items() if one.is_left]:
                cluster.kill(key)
        cluster.kill(fault.who)
        (self._disk.restore if fault.kind is Kind.RESTORED else self._disk.cut_back)()
        self._start(fault.who)
        self._ask()  # runs that the journal lacks are begun again

    def _double(self, fault: Fault, *, is_there: bool) -> None:
        """A second process of a role, with or without the first one's runs."""
        if is_there and fault.kind is Kind.MOVED:
            self._cluster.move(fault.who, away=True)
        if is_there:
            self._cluster.start(_twin(fault), fault.who if fault.who.startswith(Role.PLANNER) else "")
        else:
            self._cluster.kill(_twin(fault))
        if not is_there and fault.kind is Kind.MOVED:
            self._cluster.move(fault.who, away=False)

    def _start(self, name: str) -> None:
        """Start a process that nothing keeps down."""
        if not self._down[name]:
            self._cluster.restart(name)

    def _expire(self, process: Process, fault: Fault) -> None:
        """The others find out that a process is frozen."""
        process.is_dead_to_others = fault in process.halted
        self._cluster.tell_members()

    def _freeze(self, fault: Fault) -> None:
        """Freeze the recorder between two transactions; it has a successor when its token is gone."""
        self._disk.after_commit = lambda: None
        if (process := self._cluster.processes.get(fault.who)) is not None:
            process.halted.add(fault)
            self._cluster.at(self._cluster.now_s + LEASE_S, partial(self._succeed, process, fault))

    def _succeed(self, process: Process, fault: Fault) -> None:
        if fault in process.halted and self._cluster.processes.get(fault.who) is process:
            self._cluster.succeed(fault.who)

    def _let_go(self, fault: Fault) -> None:
        """End what halts a process, whatever its key is by now: another one may have its place."""
        for process in [one for one in self._cluster.processes.values() if fault in one.halted]:
            self._go_on(process, fault)

    def _go_on(self, process: Process, fault: Fault) -> None:
        process.halted.discard(fault)
        process.is_dead_to_others = process.is_dead_to_others and bool(process.halted)
        self._cluster.tell_members()
        self._cluster.serve(process)

    def _set(self, fault: Fault, *, is_there: bool) -> None:
        amounts = self._cluster.receiver_faults.amounts
        if fault.kind is Kind.BROKEN:
            self._disk.writes_left = int(fault.amount) if is_there else 0
        elif fault.kind is Kind.REMOVED:
            (self._disk.take_away if is_there else self._disk.put_back)()
        elif fault.kind is Kind.RECEIVER:
            (amounts.append if is_there else amounts.remove)(fault.amount)
        elif fault.kind is Kind.SLOW:
            self._disk.commit_s = fault.amount if is_there else 0.0
        elif fault.kind is Kind.SUCCESSOR:
            self._disk.after_commit = partial(self._freeze, fault) if is_there else lambda: None
            self._let_go(fault)
        else:
            self._disk.is_full = is_there
            self._disk.limit()


def _twin(fault: Fault) -> str:
    return f"{fault.who}.twin{fault.n}"


def _compare(found: Fingerprints, expected: Fingerprints) -> None:
    for run, mine in found.items():
        if mine != expected[run]:
            raise Violated(f"{run}: {mine}, but undisturbed {expected[run]}")
