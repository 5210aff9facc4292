"""A schedule: what is played, and an explicit list of faults, all drawn from one seed before anything happens.

Each schedule has its own few kinds of fault (swarm testing): a mixture of all of them hides what two of them do
together. As faults are a list, a schedule is shrunk by leaving some out.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

import numpy as np

from cogradar.services.delivery.pacing import Pacing, pacing_at
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.orders import (
    Accuracy,
    Action,
    DropTrack,
    EndRun,
    Look,
    Pause,
    PowerLimit,
    Priority,
    Resume,
    SectorSearch,
    Setting,
)
from cogradar.shared.protocol.topics import Role

SINGLE = ("recorder-0", "emulator-0", "allocator-0")
SCHEDULE = -1  # index of the generators that draw a schedule; a fault's index is its place in the list
RATE_HZ = 10.0  # of runs in real time
DWELLS = 8
LONG_DWELLS, LONG = 150, 0.03  # of this share of the schedules in real time, in which all must be well again at the end
MOST_FAULTS = 8
LEASE_S = 1.0  # after which the token of a frozen process is gone
COMMANDED, MOST_COMMANDS = 0.3, 4  # share of the schedules with commands, and how many one has
AHEAD_DWELLS = 2  # of such a run before the journal, so that a command takes effect before its end
RUN_SEEDS = 4  # worlds of each sky
_LOCKSTEP_S = 0.08  # an undisturbed run is over by then
_LATE_S, _LONGEST_S = 4.0, 4.0
_FOREVER = 0.3  # share of the planners that hang or freeze, but the first one, that never go on


class Kind(StrEnum):
    """What may go wrong."""

    LOSS = "loss"  # messages from `who` to `whom`, each with a probability
    DELAY = "delay"  # ... come later, by a time of this mean
    TWICE = "twice"  # ... come twice
    ORDER = "order"  # ... overtake each other
    CUT = "cut"  # nothing from `who` reaches `whom`; the other direction goes on
    CRASH = "crash"  # a process ends, and is started again
    LEAVE = "leave"  # a planner ends, and one of another name is started
    HANG = "hang"  # a process does nothing, though its token says that it is alive
    FREEZE = "freeze"  # ... and the others think it dead
    BEHIND = "behind"  # there is always something to read for a process
    TWIN = "twin"  # a second process of the role is there for a while
    DRIFT = "drift"  # a clock is fast, or slow
    JUMP = "jump"  # a clock leaps ahead, as after a suspended machine
    POWER = "power"  # the recorder's machine loses power in the middle of its next commit
    FULL = "full"  # no room on the recorder's disk
    SLOW = "slow"  # each commit takes so long
    RECEIVER = "receiver"  # the front end raises, or in real time also measures nonsense or nothing
    SUCCESSOR = "successor"  # the recorder is frozen after a commit, and goes on beside one that was started meanwhile
    RESTORED = "restored"  # the recorder comes back with the journal as it was when this fault began
    BROKEN = "broken"  # the n-th of the journal's next writes is an I/O error; a commit that is one may be there
    UNSYNCED = "unsynced"  # the disk keeps no sync, and then the power is cut: some last transactions are lost
    REMOVED = "removed"  # the journal's files are elsewhere for a while
    GONE = "gone"  # a planner ends and never comes back
    UNHEARD = "unheard"  # a process of a pool hears of no token for a while
    ROUTER = "router"  # ... is restarted: no message passes, and processes come back one after the other
    ROT = "rot"  # the recorder comes back, and one bit of its journal is another one
    MOVED = "moved"  # another process of the role serves the runs for a while, and this one none


LINKS = frozenset({Kind.LOSS, Kind.DELAY, Kind.TWICE, Kind.ORDER, Kind.CUT, Kind.ROUTER})
POOLS = frozenset({Kind.UNHEARD, Kind.ROUTER})
RARE = (Kind.BROKEN, Kind.UNSYNCED, Kind.REMOVED, Kind.GONE)  # drawn apart, one in RARE_SHARE of the schedules
RARE_SHARE = 0.15
MOVED_SHARE = 0.15  # likewise of the schedules in which runs are moved
ROT_SHARE = 0.04  # ... in which the journal rots: what is damaged is not over, but set aside
POOLED, POOL = 0.1, 2  # share of the schedules with pools of emulators and allocators, of so many each
_AT_POOL = (Kind.CRASH, Kind.HANG, Kind.FREEZE, Kind.FREEZE, Kind.GONE, Kind.CUT, Kind.UNHEARD, Kind.ROUTER)
MOST_AT_POOL = 3  # faults
JOINED_S = 1.0  # by then the processes of a pool have shared the runs
CLAIMED_S = 1.5  # after which the shards of a process that is gone have been claimed, as a rule
TAKEN_OVER_S = 10.0  # after a fault: lease, claims, and the checkpoint that begins a run at its new process
POOLED_HZ, POOLED_DWELLS = 2.0, 12  # of a run in real time with pools: some dwells are left after a takeover
DISK = frozenset({Kind.POWER, Kind.FULL, Kind.SLOW, Kind.ROT, Kind.RESTORED, Kind.SUCCESSOR, *RARE[:3]})
CLOCK = frozenset({Kind.DRIFT, Kind.JUMP})
# In real time nothing can be repeated, and no role runs twice at once.
_OF_LOCKSTEP = frozenset({Kind.RESTORED, Kind.UNSYNCED, Kind.TWIN, Kind.ROT})
# km/s and s cannot be mixed up here: probability, s, or factor.
_AMOUNTS = {
    Kind.LOSS: (0.02, 0.7),
    Kind.DELAY: (0.001, 1.0),
    Kind.TWICE: (0.05, 1.0),
    Kind.ORDER: (0.05, 1.0),
    Kind.DRIFT: (0.9, 1.1),
    Kind.JUMP: (0.01, 3.0),
    Kind.SLOW: (0.001, 1.0),
    Kind.RECEIVER: (1.0, 4.0),  # which of the three
    Kind.BROKEN: (1.0, 100.0),  # n
}


@dataclass(frozen=True)
class Fault:
    """One fault, from when to when in simulated time; until infinity if it never ends."""

    kind: Kind
    at_s: float
    until_s: float
    who: str
    whom: str = ""
    amount: float = 0.0
    n: int = 0  # its place in the list that was drawn: key of its random numbers

    @property
    def settled_s(self) -> float:
        """When it is over; of one that never is, when it begins."""
        return self.until_s if self.until_s < math.inf else self.at_s

    def touches(self, role: Role) -> bool:
        """Whether it is of a process of a role, or of a link from or to one."""
        return role in self.who or role in self.whom or self.kind is Kind.ROUTER

    def __str__(self) -> str:
        whom = f" to {self.whom}" if self.whom else ""
        amount = f" {self.amount:.3g}" if self.amount else ""
        return f"{self.at_s:.4f} .. {self.until_s:.4f} s: {self.kind}{amount} {self.who}{whom}"


@dataclass(frozen=True)
class Asked:
    """A command to one of the runs."""

    run: int  # its place among the runs
    action: Action
    at: int  # not before this dwell
    asked_s: float = 0.0  # when, after the run was asked for

    def __str__(self) -> str:
        return f"run {self.run}, dwell {self.at}, {self.asked_s:.4f} s: {self.action!r}"


@dataclass(frozen=True)
class Schedule:
    """What is played, and what goes wrong meanwhile."""

    seed: int
    sky: str  # a name of `cogradar.services.simulation.skies`
    run_seed: int
    rate_hz: float  # 0: in lockstep
    planners: int
    runs: int  # at once
    checkpoint_dwells: int
    snapshot_dwells: int
    prepares: bool  # processes prepare for what comes next while they are idle
    faults: tuple[Fault, ...]
    commands: tuple[Asked, ...] = ()
    dwells: int = DWELLS
    pool: int = 1  # emulators and allocators

    @classmethod
    def draw(cls, seed: int) -> Self:
        """The schedule of a seed."""
        rng = generator(seed, Purpose.FAULT, SCHEDULE, 0)
        rate_hz = RATE_HZ if rng.random() < 0.3 else 0.0
        is_long = rate_hz > 0.0 and generator(seed, Purpose.FAULT, SCHEDULE, 1).random() < LONG
        made = cls(
            seed=seed,
            sky=("known", "unknown")[int(rng.random() < 0.4)],
            run_seed=1 + int(rng.integers(RUN_SEEDS)),
            rate_hz=rate_hz,
            planners=1 + int(rng.integers(3)),
            runs=1 + int(rng.random() < 0.15),
            checkpoint_dwells=(2, 4, 16)[rng.integers(3)],
            snapshot_dwells=(2, 4, 256)[rng.integers(3)],
            prepares=bool(rng.random() < 0.25),
            faults=(),
            dwells=LONG_DWELLS if is_long else DWELLS,
        )
        pool_rng = generator(seed, Purpose.FAULT, SCHEDULE, 4)
        if pool_rng.random() < POOLED:
            made = replace(made, pool=POOL)
            made = replace(made, rate_hz=POOLED_HZ, dwells=POOLED_DWELLS) if rate_hz else made
        others = made._pooled(pool_rng) if made.pool > 1 else made._moved()
        faulty = replace(made, faults=(*made._faults(rng), *made._rare(), *others, *made._rotten()))
        if not rate_hz:
            is_commanded = rng.random() < COMMANDED
            return replace(faulty, commands=faulty._over_time(faulty._commands(rng))) if is_commanded else faulty
        return faulty._limited()

    @property
    def pacing(self) -> Pacing:
        """When the dwells of its runs happen."""
        return pacing_at(self.rate_hz)

    @property
    def names(self) -> tuple[str, ...]:
        """Processes that are there from the start, and again once all faults are over."""
        others = (f"{role}-{i}" for i in range(1, self.pool) for role in ("emulator", "allocator"))
        return (*SINGLE, *others, *(f"planner-{i}" for i in range(self.planners)))

    @property
    def begins_s(self) -> float:
        """When its runs are asked for."""
        return JOINED_S if self.pool > 1 else 0.0

    @property
    def takeover_s(self) -> float:
        """For how long after a fault a run may be without a process that serves it."""
        return TAKEN_OVER_S if self.pool > 1 else 0.0

    @property
    def quiet_s(self) -> float:
        """When the last fault is over, or goes on for ever."""
        return max((fault.settled_s for fault in self.faults), default=0.0)

    def plain(self, commands: tuple[Asked, ...] = ()) -> Self:
        """The same run undisturbed, by one planner, under these commands."""
        quiet = replace(self, seed=0, planners=1, pool=1, snapshot_dwells=256, prepares=False)
        quiet = replace(quiet, faults=(), commands=commands)
        # A run that may be only little ahead of the journal would wait for each checkpoint.
        return replace(quiet, checkpoint_dwells=1 if commands else 16)

    def without(self, fault: Fault) -> Self:
        """The same with a fault less."""
        return replace(self, faults=tuple(one for one in self.faults if one is not fault))

    def __str__(self) -> str:
        pace = f"{self.rate_hz:g} dwells/s" if self.pacing.has_deadlines else "lockstep"
        pools = f" pools of {self.pool}," if self.pool > 1 else ""
        return (
            f"seed {self.seed}: {self.runs} x {self.sky} {self.run_seed}, {pace}, {self.planners} planners,{pools}"
            f" checkpoints every {self.checkpoint_dwells}, snapshots every {self.snapshot_dwells}"
        )

    def _faults(self, rng: np.random.Generator) -> tuple[Fault, ...]:
        others = _OF_LOCKSTEP if self.pacing.has_deadlines else CLOCK
        possible = sorted(set(Kind) - {*RARE, *POOLS, Kind.MOVED, Kind.ROT} - others)
        kinds = [possible[i] for i in rng.choice(len(possible), size=1 + rng.integers(4), replace=False)]
        n = int(rng.integers(1, MOST_FAULTS + 1))
        return tuple(self._fault(kinds[rng.integers(len(kinds))], i, rng) for i in range(n))

    def _rare(self) -> tuple[Fault, ...]:
        """One of the rare faults, or none."""
        rng = generator(self.seed, Purpose.FAULT, SCHEDULE, 2)
        possible = [kind for kind in RARE if not (self.pacing.has_deadlines and kind in _OF_LOCKSTEP)]
        if self.planners == 1:
            possible.remove(Kind.GONE)
        is_drawn = rng.random() < RARE_SHARE
        return (self._fault(possible[rng.integers(len(possible))], MOST_FAULTS, rng),) if is_drawn else ()

    def _moved(self) -> tuple[Fault, ...]:
        rng = generator(self.seed, Purpose.FAULT, SCHEDULE, 3)
        return (self._fault(Kind.MOVED, MOST_FAULTS + 1, rng),) if rng.random() < MOVED_SHARE else ()

    def _rotten(self) -> tuple[Fault, ...]:
        rng = generator(self.seed, Purpose.FAULT, SCHEDULE, 6)
        is_drawn = rng.random() < ROT_SHARE and not self.pacing.has_deadlines
        return (self._fault(Kind.ROT, MOST_FAULTS + 3 + MOST_AT_POOL, rng),) if is_drawn else ()

    @property
    def is_rotten(self) -> bool:
        """Whether a byte of the journal is changed."""
        return any(fault.kind is Kind.ROT for fault in self.faults)

    def _pooled(self, rng: np.random.Generator) -> tuple[Fault, ...]:
        """Faults of the processes of one pool, and of what they see of each other; of each pool one stays."""
        role, made = ("emulator", "allocator")[rng.integers(2)], list[Fault]()
        for n in range(MOST_FAULTS + 2, MOST_FAULTS + 3 + int(rng.integers(MOST_AT_POOL))):
            fault = self._fault(_AT_POOL[rng.integers(len(_AT_POOL))], n, rng)
            i = int(rng.integers(POOL))
            if fault.kind is Kind.ROUTER:
                fault = replace(fault, who="", whom="")
            elif fault.kind is Kind.CUT:
                fault = replace(fault, who=f"{role}-{i}", whom=f"{role}-{1 - i}")
            elif fault.until_s == math.inf and fault.kind is Kind.HANG:  # it would keep what it has claimed
                fault = replace(fault, who=f"{role}-{i}", until_s=fault.at_s + _LONGEST_S)
            else:
                fault = replace(fault, who=f"{role}-{1 if fault.until_s == math.inf else i}")
            if fault.kind is Kind.FREEZE:  # else nothing is taken over
                fault = replace(fault, until_s=fault.until_s + LEASE_S + CLAIMED_S)
            made.append(fault)
        return tuple(made)

    def _commands(self, rng: np.random.Generator) -> tuple[Asked, ...]:
        actions: list[Action] = [PowerLimit(share=0.5), PowerLimit(share=1.0), EndRun()]
        actions += [Pause(), Pause(dwells=2), Resume(), Setting(key="strategy", value="orthogonal")]
        actions += [Setting(key="strategy", value="uniform"), Setting(key="objective", value="urgency")]
        tracks = range(2 if self.sky == "known" else 6)  # of an unknown number some begin after the dwell of the order
        actions += [Priority(track=m, weight=weight) for m in tracks for weight in (1.0, 5.0)]
        if self.sky == "known":
            actions += [Setting(key="rule", value="mode"), Setting(key="rule", value="mean")]
        if self.sky == "unknown":
            actions += [Accuracy(track=m, km=km) for m in tracks for km in (0.05, 1.0, None)]
            actions += [DropTrack(track=m) for m in tracks]
            actions += [SectorSearch(from_deg=-90, to_deg=0, search="blank"), Look(bearing_deg=20, dwells=2, share=0.3)]
            actions += [SectorSearch(from_deg=-20, to_deg=90, search="double")]
            actions += [SectorSearch(from_deg=-90, to_deg=90, search="normal")]
        n = int(rng.integers(1, MOST_COMMANDS + 1))
        chosen = zip(rng.integers(len(actions), size=n).tolist(), rng.integers(DWELLS, size=n).tolist(), strict=True)
        return tuple(Asked(int(rng.integers(self.runs)), actions[i], at) for i, at in chosen)

    def _over_time(self, commands: tuple[Asked, ...]) -> tuple[Asked, ...]:
        """In half of the schedules commands are asked while a run goes on, for the next dwell that they can shape."""
        rng = generator(self.seed, Purpose.FAULT, SCHEDULE, 7)
        if rng.random() < 0.5:
            return commands
        return tuple(replace(one, at=0, asked_s=float(rng.random()) * _LOCKSTEP_S) for one in commands)

    def _limited(self) -> Self:
        """In real time: commands that limit what is radiated, of one emulator, which then has some dwells to obey."""
        rng = generator(self.seed, Purpose.FAULT, SCHEDULE, 5)
        moved = any(fault.kind is Kind.MOVED for fault in self.faults)
        if moved or self.pool > 1 or self.dwells > DWELLS or rng.random() >= COMMANDED:
            return self
        # No pause without an end: while targets are acquired, the clock of the run stands still with it.
        actions: list[Action] = [PowerLimit(share=0.5), PowerLimit(share=1.0), Pause(dwells=2)]
        drawn = rng.integers((self.runs, len(actions), DWELLS), size=(1 + rng.integers(MOST_COMMANDS), 3)).tolist()
        return replace(self, dwells=2 * DWELLS, commands=tuple(Asked(run, actions[i], at) for run, i, at in drawn))

    def _fault(self, kind: Kind, n: int, rng: np.random.Generator) -> Fault:
        usual = self.pacing.seconds(2 * DWELLS) or _LOCKSTEP_S
        at_s = float(rng.random()) * (usual if rng.random() < 0.8 else _LATE_S)
        length_s = _between(rng, 0.001, _LONGEST_S)
        who, whom = self.names[rng.integers(len(self.names))], ""
        if kind in LINKS:
            whom = self.names[rng.integers(len(self.names))]
        elif kind is Kind.LEAVE:
            who = f"planner-{rng.integers(self.planners)}"
        elif kind in DISK:
            who = "recorder-0"
        elif kind is Kind.RECEIVER:
            who = "emulator-0"
        elif kind is Kind.TWIN:
            who = [name for name in self.names if name != "recorder-0"][rng.integers(len(self.names) - 1)]
        elif kind is Kind.MOVED:
            who = SINGLE[1 + rng.integers(2)]
        if kind is Kind.SUCCESSOR:
            length_s += LEASE_S  # else it has none
        elif kind is Kind.GONE:
            who, length_s = f"planner-{1 + rng.integers(max(self.planners - 1, 1))}", math.inf
        is_one_of_many = who.startswith("planner") and who != "planner-0"
        if kind in {Kind.HANG, Kind.FREEZE} and is_one_of_many and rng.random() < _FOREVER:
            length_s = math.inf
        low_high = _AMOUNTS.get(kind)
        amount = _between(rng, *low_high) if low_high else 0.0
        at_s += self.begins_s
        return Fault(kind, at_s, at_s + length_s, who, whom, amount, n)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return math.exp(float(rng.uniform(math.log(low), math.log(high))))
