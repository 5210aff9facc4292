"""One run as the recorder receives it: which dwells are complete, and what a checkpoint says of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from cogradar.services.delivery.invariant import require
from cogradar.services.delivery.order_book import Moment, OrderBook
from cogradar.services.delivery.pacing import REST_S, pacing_at
from cogradar.services.recorder.overdue import OverduePlans
from cogradar.services.recorder.retransmit_timer import FIRST, SLOW, RetransmitTimer
from cogradar.services.recorder.run_digest import RunDigest
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.admission import check_dwell, check_parts, check_plan, check_roster, check_snapshot
from cogradar.shared.protocol.messages import (
    MAX_REASON,
    Checkpoint,
    Command,
    EmulatorCheckpoint,
    Lead,
    Plan,
    Refused,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
    roster_of,
)
from cogradar.shared.protocol.orders import Order
from cogradar.shared.protocol.recovery import Snapshot
from cogradar.shared.protocol.slots import may_plan
from cogradar.shared.scenario.faults import listed
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.wire.runner import TICK_S

OfDwell = Scan | Truth | Plan | Waveform
# Ticks after which a checkpoint is repeated, for a process that joins: while it stands still; while others go on.
REPEAT, REPEAT_SHARED = round(1.0 / TICK_S), round(4.0 / TICK_S)
# So long without the plan of a track, and its owner loses it. In lockstep it is longer where plans have taken long
# before, and twice as long each time. A planner that only is slow would be slower with the tracks of others.
OVERDUE_S = 3.0
OVERDUE_SHARED = 4  # times as long while others go on: it may only wait for its turn
UNPLANNED = 4  # times as long, before its first plan, until it is said of a planner: it may still be loading
_OVERDUE_TICKS = round(OVERDUE_S / TICK_S)
ASK_TICKS = 3  # in real time: from a request for a scan to the next
MAX_HINDERED = 8  # processes of which it is kept why they cannot do their part
NAMED = 5  # planners that are waited for, and tracks
HINDERED_S = 10.0  # after it was said last it is over: the longest time between two checkpoints is 4 s
_HINDERED_TICKS = round(HINDERED_S / TICK_S)


@dataclass
class _Dwell:
    """What has come of one dwell."""

    since: int  # tick of its first message
    t: int | None = None  # of its scan,
    scan_at: int = 0  # ... and the tick at which it came
    planned_at: int = 0  # tick at which it had all plans
    n_message: int = 0
    has_truth: bool = False
    has_waveform: bool = False
    plans: set[int] = field(default_factory=set)  # tracks
    tracks: frozenset[int] = frozenset()  # whose plans it needs, as its scan says
    born_ks: Mapping[int, int] = field(default_factory=dict)  # dwell with whose scan each of them began


class RecordedRun:
    """Takes messages in any order; completes dwells in order."""

    def __init__(
        self, start: RunStart, k: int = 0, t: int = 0, orders: Sequence[Order] = (), *, resumed: bool = False
    ) -> None:
        """A run of which dwells 0 .. k-1 are acknowledged. `resumed`: messages may have been missed meanwhile."""
        self.start = start
        self.digest = RunDigest(start.run)
        self.k = k  # dwells that are complete
        self.t = t  # clock of the last one
        self.acknowledged = (k, t)  # ... and as of the last checkpoint
        self.n_message = 0  # of these dwells, in the journal
        self.n_command = 0  # number of the last one in the journal
        self.leads: list[Lead] = []  # of the last epochs, with the one of its recorder
        self.tracks: frozenset[int] | None = None  # of the last scan of these dwells,
        self.born_ks: Mapping[int, int] = {}  # ... when they began,
        self.known_k = -1  # ... and its dwell
        self._plans: dict[int, Plan] = {}  # newest of each track that is there
        self.end: RunEnd | None = None
        self._hindered: dict[str, str] = {}  # processes that cannot do their part, and why; "": what is overdue
        self._hindered_at: dict[str, int] = {}  # when they said so last
        self._overdue: tuple[int, ...] = ()  # tracks; said in the next checkpoint
        self._overdue_at = _OVERDUE_TICKS  # ticks after a scan
        self._longest = 0  # ... until a dwell had all plans
        self.is_closing = False  # in real time, after the end: nothing more will come
        self._radar = RadarConfig.model_validate(start.scenario["radar"])
        self._has_truth = start.scenario["world"] is not None
        self.pacing = pacing_at(start.rate_hz)
        self.orders = OrderBook(self._radar, start.strategy, self.pacing, orders)
        self._overdue_plans = OverduePlans(self.pacing)
        self._timer = RetransmitTimer(max(FIRST, round(self.pacing.silence_s / TICK_S)))
        self._is_resumed = resumed
        self._has_plan = False  # any has come
        self._awaited_at: int | None = None  # tick since which one is awaited
        self.has_news = False  # a message of dwell k or later has come since the last tick
        self.wants_repeat = False  # its checkpoint is to be said again, though nothing is asked for
        self._is_shared = False  # others go on
        self._ticks = 0
        self._inactive = 0  # ticks since a dwell was completed
        self._dwells: dict[int, _Dwell] = {}  # k and later, in the order of their first messages
        self._heard_k, self._heard_t = -1, 0  # dwell and clock of the newest scan,
        self._heard_at: int | None = None  # ... and tick at which it came; None: before the first one

    def check(self, message: OfDwell | Snapshot) -> None:
        """Refuse a message that does not match the run's number of dwells, of tracks or of targets.

        Likewise one of a dwell to which no process comes by what this journal says: its sender was told of more.
        """
        check_dwell(message.k, self._radar, self.start.dwells, getattr(message, "t", 0))
        there = self.acknowledged[0]
        if not self.pacing.may_answer(message.k - there):
            why = "was an older journal put in place?"
            raise Refused(f"dwell {message.k}, though only those before {there} are acknowledged: {why}")
        match message:
            case Snapshot():
                check_snapshot(message, self._radar)
            case Plan():
                check_plan(message, self._radar)
            case Truth():
                world = self.start.scenario["world"]
                if world is None or message.bins.size != len(world["targets"]):
                    raise Refused(f"truth of {message.bins.size} targets")
            case Scan() | Waveform():
                answered = message.k + isinstance(message, Waveform)
                check_parts(message, self._radar)
                check_roster(message.roster, message.beams, self._radar, answered)

    def hinder(self, process: str, reason: str) -> bool:
        """Note why a process cannot do its part; whether that is news."""
        if process not in self._hindered and len(self._hindered) >= MAX_HINDERED:
            return False
        is_news = self._hindered.get(process) != reason
        self._hindered[process], self._hindered_at[process] = reason, self._ticks
        return is_news

    @property
    def lacks_plans(self) -> bool:
        """Whether it was noted that plans are overdue, and is not over."""
        return "" in self._hindered

    def hinder_overdue(self, planners: Sequence[str]) -> bool:
        """Note which planners could bring the plans that are overdue, as far as none says so of another; whether that
        is news.
        """
        if not self._overdue or not self._is_awaited():
            return False
        able = [name for name in planners if any(may_plan(name, track) for track in self._overdue)]
        tracks = listed([str(track + 1) for track in self._overdue], NAMED)
        return self.hinder("", f"no plans of track {tracks}; planners present: {listed(able, NAMED) or 'none'}")

    def _is_awaited(self) -> bool:
        """Whether there were plans, or the first one is awaited for so long that no planner is still loading."""
        since = self._ticks if self._awaited_at is None else self._awaited_at
        return self._has_plan or self._ticks - since >= UNPLANNED * _OVERDUE_TICKS

    def forgive(self) -> bool:
        """Forget the processes that have not said so again, as they do at each checkpoint; whether there is one."""
        if "" in self._hindered and not self.pacing.has_deadlines and self._unplanned(_OVERDUE_TICKS):
            self._hindered_at[""] = self._ticks  # it still waits for plans
        able = [process for process, at in self._hindered_at.items() if self._ticks - at > _HINDERED_TICKS]
        for process in able:
            del self._hindered[process], self._hindered_at[process]
        return bool(able)

    @property
    def hindrances(self) -> str:
        """What processes cannot do their part for."""
        # Several planners say the same of late ones.
        said = dict.fromkeys(self._hindered[process] for process in sorted(self._hindered) if process)
        return ("; ".join(said) or self._hindered.get("", ""))[:MAX_REASON]

    def take(self, message: OfDwell) -> None:
        """Note a message of dwell k or later."""
        self.has_news = True
        dwell = self._dwells.setdefault(message.k, _Dwell(self._ticks))
        dwell.n_message += 1
        goes_on = self.pacing.has_deadlines and isinstance(message, Scan)
        if goes_on:
            self._inactive = 0  # to resend old dwells would only make the next ones late
        if goes_on or message.k == self.k:
            self._timer.hear()
        match message:
            case Scan():
                if message.k > self._heard_k:
                    self._heard_k, self._heard_t, self._heard_at = message.k, message.t, self._ticks or None
                dwell.t, dwell.scan_at = message.t, self._ticks
                roster = roster_of(message)
                dwell.born_ks = dict(zip(roster.ids.tolist(), roster.born_k.tolist(), strict=True))
                dwell.tracks = frozenset(dwell.born_ks)
                self._overdue_plans.hear_scan(message.k, dwell.tracks)
                if dwell.tracks and self._awaited_at is None:
                    self._awaited_at = self._ticks
            case Truth():
                dwell.has_truth = True
            case Waveform():
                dwell.has_waveform = True
            case Plan():
                self._has_plan = True
                dwell.plans.add(message.target)
                if message.target not in self._plans or message.k > self._plans[message.target].k:
                    self._plans[message.target] = message
                self._overdue_plans.hear_plan(message.k, message.target)
        if isinstance(message, Scan | Plan) and self._is_planned(dwell):
            dwell.planned_at = self._ticks

    def grant(self, command: Command, n: int) -> tuple[Order, list[Order]]:
        """The order that a command becomes, and those that it replaces. Raises Refused."""
        newest = max((k for k, dwell in self._dwells.items() if dwell.t is not None), default=None)
        if 0 < command.at <= (last_scan := self.k - 1 if newest is None else newest):
            raise Refused(f"dwell {command.at} has passed: the newest one is {last_scan}")
        tracks = self._dwells[newest].tracks if newest is not None else self.tracks or frozenset()
        left = (
            self.start.dwells
            - self.t
            + (0 if self._radar.is_unknown or self.t else 2 * self._radar.acquisition.max_scans)
        )
        t = self.t if newest is None else self._dwells[newest].t
        is_acquiring = t == 0 and not self._radar.is_unknown
        newest_k = newest if newest is not None else self.k - is_acquiring
        at = Moment(newest_k, self.acknowledged[0], self.k + left - 1, tracks, self._plans, is_acquiring)
        return self.orders.grant(command, n, at)

    def validate(self, journalled: tuple[int, ...]) -> None:
        """What was said to be acknowledged is `journalled`, and no more than is complete. Raises BrokenInvariant."""
        require(self.acknowledged == journalled, f"{self.acknowledged} is acknowledged, the journal has {journalled}")
        require(self.acknowledged[0] <= self.k, f"{self.acknowledged[0]} dwells are acknowledged of {self.k}")
        require(min(self._dwells, default=self.k) >= self.k, "a dwell that is complete is open")

    def is_ready(self) -> bool:
        """Whether dwell k is complete or, in real time, what is missing of it will not come any more."""
        if (dwell := self._dwells.get(self.k)) is not None and self._is_complete(dwell):
            return True
        has_ended = self.is_closing and self.end is not None and self.k <= self.end.k
        # By the clock, not by how many dwells have come since: what the recorder missed while it was away comes all at
        # once, and topic by topic.
        since = next((dwell.since for dwell in self._dwells.values() if dwell.t is not None), self._ticks)
        rest_s = self.pacing.rest_s + REST_S * self._is_resumed
        return has_ended or (self._ticks - since) * TICK_S >= rest_s

    def complete(self) -> None:
        """Dwell k is complete: go on to the next one."""
        dwell = self._dwells.pop(self.k, None)
        self.n_message += 0 if dwell is None else dwell.n_message
        if dwell is not None and dwell.t is not None:
            self.t, self.tracks, self.born_ks, self.known_k = dwell.t, dwell.tracks, dwell.born_ks, self.k
            self._plans = {m: plan for m, plan in self._plans.items() if m in dwell.tracks or plan.k > self.k}
        elif self.t > 0 or self._radar.is_unknown:
            self.t = min(self.t + 1, self.start.dwells)  # the scan is missing; the targets fly on, to the last dwell
        if dwell is not None and not self.pacing.has_deadlines:
            self._longest = max(self._longest, dwell.planned_at - dwell.scan_at)
        self._overdue_at = max(_OVERDUE_TICKS, SLOW * self._longest)
        if self.pacing.has_deadlines:
            self._timer.hear()
        else:
            self._timer.learn()
        self.k, self._inactive = self.k + 1, 0
        self.wants_repeat = False

    @property
    def is_over(self) -> bool:
        """Whether it has ended and all of it is there, or the rest does not matter."""
        return self.end is not None and (self.k > self.end.k or self.end.status != "complete")

    def tick(self, *, others_go_on: bool) -> None:
        """A tick has passed; `others_go_on`: messages of other runs in lockstep came meanwhile.

        In real time, some after the end, the last dwells are completed as they are.
        """
        self._ticks, self.has_news = self._ticks + 1, False
        self._is_shared = others_go_on = others_go_on and not self.pacing.has_deadlines
        self._inactive += 1
        self._timer.tick()
        self.wants_repeat = self._inactive % (REPEAT_SHARED if others_go_on else REPEAT) == 0
        overdue_at = self._overdue_at * (OVERDUE_SHARED if others_go_on else 1)
        if self.pacing.has_deadlines:
            self._overdue = tuple(sorted({*self._overdue, *self._overdue_plans.take()}))
        elif unplanned := self._unplanned(overdue_at):
            self._overdue = unplanned
            self._overdue_at *= 2
        self.is_closing = self.pacing.loses_dwells and self.end is not None and self._inactive * TICK_S >= REST_S

    def _unplanned(self, ticks: int) -> tuple[int, ...]:
        """Tracks without a plan of dwell k, so many ticks after its scan."""
        dwell = self._dwells.get(self.k)
        if dwell is None or dwell.t is None or self._ticks - dwell.scan_at < ticks:
            return ()
        return tuple(sorted(dwell.tracks - dwell.plans))

    @property
    def has_overdue(self) -> bool:
        """Whether others must hear at once whose plans are overdue: in real time."""
        return bool(self._overdue) and self.pacing.has_deadlines

    @property
    def wants_resend(self) -> bool:
        """Whether messages must be asked for again: it stands still, or a second ago it was resumed in real time."""
        if self._is_resumed and self.pacing.has_deadlines and self._ticks * TICK_S == 1.0:
            return True
        is_overdue = bool(self._overdue and not self.pacing.has_deadlines)
        return self._asks_for_scan or is_overdue or self._timer.is_over(is_shared=self._is_shared)

    @property
    def _asks_for_scan(self) -> bool:
        """Whether dwell k lacks its scan in real time, although a later one came a while ago: now and then."""
        dwell = self._dwells.get(self.k)
        if not self.pacing.has_deadlines or (dwell is not None and dwell.t is not None):
            return False
        shown = next((dwell.since for dwell in self._dwells.values() if dwell.t is not None), self._ticks)
        return (self._ticks - shown) % ASK_TICKS == 1

    @property
    def revision(self) -> int:
        """How far it is in the journal. It grows with all that processes are told of."""
        return self.acknowledged[0] + self.n_command

    def checkpoint(self, *, resend: bool = False, ended: bool = False, held: bool = False) -> list[Checkpoint]:
        """How far the run is acknowledged, for the radar's processes and for the emulator."""
        k, t = self.acknowledged
        now = {"k": k, "t": t, "resend": resend, "ended": ended, "held": held, "overdue": list(self._overdue)}
        now |= {"orders": list(self.orders.orders), "lacking": self._lacking() if resend else None}
        now |= {"revision": self.revision, "leads": self.leads}
        self._overdue = ()
        if resend:
            self._timer.ask()
        of_radar, of_emulator = self._first
        return [of_radar.model_copy(update=now), of_emulator.model_copy(update=now | self._due())]

    def _due(self) -> dict[str, int]:
        """In real time the newest scan, and the dwell that is due, by the clock since then.

        The clock of a recorder that comes back begins with the first scan that it hears: all may have been away.
        """
        if not self.pacing.loses_dwells or (newest_k := max(self._heard_k, self.k - 1)) < 0:
            return {}
        whole_ticks = 0 if self._heard_at is None else max(self._ticks - self._heard_at - 1, 0)
        due_k = min(newest_k + 1 + self.pacing.skipped(whole_ticks * TICK_S), NO_END)
        newest_t = self._heard_t if newest_k == self._heard_k else self.t
        return {"newest_k": newest_k, "newest_t": newest_t, "due_k": due_k}

    @cached_property
    def _first(self) -> tuple[Checkpoint, EmulatorCheckpoint]:
        """The checkpoints with which it begins. Radar and world are checked once: hundreds of targets take 10 ms."""
        start = self.start
        settings: dict[str, Any] = {"run": start.run, "strategy": start.strategy, "dwells": start.dwells}
        settings |= {"rate_hz": start.rate_hz, "radar": start.scenario["radar"], "seed": radar_seed(start.seed)}
        world = {"world": start.scenario["world"], "world_seed": start.seed}
        return Checkpoint(**settings, k=0, t=0), EmulatorCheckpoint(**settings, **world, k=0, t=0)

    def _lacking(self) -> list[int] | None:
        """The tracks for whose plans all wait; None if something else is lacking, too, or later dwells have begun.

        If it is only the waveform: none at first, since the allocator may be at it; then all, since it may lack some.
        """
        if self._asks_for_scan:
            return []
        dwell = self._dwells.get(self.k)
        if dwell is None or len(self._dwells) > 1 or dwell.t is None or dwell.has_truth != self._has_truth:
            return None
        missing = sorted(dwell.tracks - dwell.plans)
        return missing if missing or not self._timer.was_asked else None

    @property
    def awaits_waveform(self) -> bool:
        """Whether dwell k lacks its waveform alone, though it was asked for: the allocator may lack plans."""
        dwell = self._dwells.get(self.k)
        return self._timer.was_asked and dwell is not None and not dwell.has_waveform and self._is_planned(dwell)

    def _is_complete(self, dwell: _Dwell) -> bool:
        has_truth = dwell.has_truth or not self._has_truth
        return has_truth and dwell.has_waveform and self._is_planned(dwell)

    def _is_planned(self, dwell: _Dwell) -> bool:
        is_all_planned = len(dwell.plans) >= len(dwell.tracks) and dwell.tracks <= dwell.plans
        return dwell.t is not None and is_all_planned
