"""The faults that `tests.mutants` plants in the program: each is one replacement in the source of one module."""

from collections.abc import Callable
from typing import Any, NamedTuple


def of_any_kind(_schedule: Any) -> bool:
    """All schedules."""
    return True


class Mutant(NamedTuple):
    """A fault that can be planted."""

    name: str
    module: str  # file, from the root
    old: str
    new: str
    harmless: str = ""  # why no run can be another with it; "": it must be found
    only: Callable[[Any], bool] = of_any_kind  # schedules that come to its place: those are played, and counted
    missed: str = ""  # why no schedule is known in which it does harm, though it is not proven to be harmless


def with_a_flipped_bit(schedule: Any) -> bool:
    """Schedules in which a bit of the journal is another one."""
    return any(fault.kind == "rot" for fault in schedule.faults)


def in_real_time(schedule: Any) -> bool:
    """Schedules of runs in real time."""
    return bool(schedule.rate_hz)


def with_pools(schedule: Any) -> bool:
    """Schedules with several emulators and allocators."""
    return bool(schedule.pool > 1)


def with_pools_and_a_router_that_restarts(schedule: Any) -> bool:
    """Schedules with pools whose router is away for a while."""
    return with_pools(schedule) and any(fault.kind == "router" for fault in schedule.faults)


def that_go_on_for_long(schedule: Any) -> bool:
    """Schedules in real time of several planners, in which all is well again long before the end."""
    return bool(schedule.dwells > 100 and schedule.planners > 1)


def whose_journal_is_put_back(schedule: Any) -> bool:
    """Schedules in lockstep in which an older journal is put in place."""
    return any(fault.kind in {"restored", "unsynced"} for fault in schedule.faults)


def with_commands_and_a_journal_that_is_put_back(schedule: Any) -> bool:
    """... and that have commands."""
    return bool(schedule.commands) and whose_journal_is_put_back(schedule)


def with_commands(schedule: Any) -> bool:
    """Schedules whose runs are commanded."""
    return bool(schedule.commands)


RECORDER, RUN, JOURNAL = (
    "services/recorder/core.py",
    "services/recorder/recorded_run.py",
    "services/recorder/journal.py",
)
PLANNER, PLANNED, HELD = "services/planner/core.py", "services/planner/run.py", "services/planner/held_tracks.py"
ALLOCATOR, EMULATOR = "services/allocator/core.py", "services/emulator/core.py"
TRANSMITTED = "services/emulator/dwell.py"
MEMBERS, SHARES = "shared/wire/pool/members.py", "shared/wire/pool/shares.py"
PACING, RESEND = "services/delivery/pacing.py", "services/delivery/resend.py"
EPOCHS = "shared/wire/epochs.py"

MUTANTS = (
    # Recorder and journal.
    Mutant(
        "a checkpoint is sent before its transaction is committed",
        RECORDER,
        "        self._journal.commit()\n        self._uncommitted_ticks = 0",
        "        self._uncommitted_ticks = 0",
    ),
    Mutant(
        "a dwell is complete without its waveform",
        RUN,
        "has_truth and dwell.has_waveform and self._is_planned(dwell)",
        "has_truth and self._is_planned(dwell)",
    ),
    Mutant("a dwell is complete without its truth", RUN, "dwell.has_truth or not self._has_truth", "True"),
    Mutant(
        "the recorder never asks for anything again",
        RUN,
        "        k, t = self.acknowledged\n        now =",
        "        (k, t), resend = self.acknowledged, False\n        now =",
    ),
    Mutant(
        "a recorder that comes back begins unfinished runs at the next dwell",
        RECORDER,
        "RecordedRun(start, k, t",
        "RecordedRun(start, k + 1, t",
    ),
    Mutant(
        "the first message of a dwell is overwritten by a later one",
        JOURNAL,
        "INSERT INTO message VALUES (?,?,?,?,?,?) ON CONFLICT DO NOTHING",
        "INSERT OR REPLACE INTO message VALUES (?,?,?,?,?,?)",
    ),
    Mutant(
        "snapshots of dwells that are not acknowledged are kept",
        RECORDER,
        "if snapshot.k >= run.acknowledged[0]:",
        "if snapshot.k >= run.acknowledged[0] + 999:",
        harmless="planners send none before they are told so, and what a lost journal had told them is dropped",
    ),
    Mutant(
        "checksums of messages are not looked at",
        JOURNAL,
        "message_checksum(run, k, topic, item, payload) != known",
        "known is None",
        only=with_a_flipped_bit,
    ),
    Mutant(
        "an older snapshot replaces a newer one",
        JOURNAL,
        "payload = excluded.payload WHERE excluded.k > snapshot.k",
        "payload = excluded.payload",
        harmless="a new owner observes more scans, and is where it would be",
    ),
    Mutant(
        "messages before their run begins are dropped by the recorder",
        RECORDER,
        "                self._pending.add(message)\n            return ()",
        "                pass\n            return ()",
        harmless="they are asked for again",
    ),
    Mutant(
        "a deposed recorder goes on",
        RECORDER,
        "if heard.epoch > journal.epoch:",
        "if False:",
        harmless="the look for a higher epoch inside each transaction ends it",
    ),
    Mutant(
        "epochs are not looked at inside a transaction",
        "services/recorder/store/database.py",
        "if self.epoch and (newest := self._newest()).epoch > self.epoch:",
        "if (newest := self._newest()).epoch < 0:",
    ),
    Mutant("overdue plans are never named", RUN, '"overdue": list(self._overdue)', '"overdue": []'),
    Mutant(
        "an order is told of from the next checkpoint on only",
        RECORDER,
        "return [*answers, *run.checkpoint()]",
        "return answers",
        harmless="no dwell that it shapes is answered before a later checkpoint, which says it, too",
    ),
    # Planners.
    Mutant(
        "the death of a planner is not noticed",
        PLANNER,
        "self._workers = tuple(sorted(there))",
        "self._workers = tuple(sorted({*there, *self._workers}))",
        missed="3 s later its plans are overdue, and others take its tracks; tests of takeovers within 2 s find it",
    ),
    Mutant(
        "no track is taken from a planner that brings no plans",
        PLANNER,
        "if not overdue or self._now_s <",
        "if True or self._now_s <",
    ),
    Mutant(
        "searches go on with the random numbers of the one before",
        "services/planner/decision.py",
        "rng = generator(model.seed, Purpose.SEARCH, state.target, state.k)",
        'rng = globals().setdefault("_rng", generator(model.seed, Purpose.SEARCH, 0, 0))',
    ),
    Mutant(
        "a track that is restored lacks a dwell",
        PLANNED,
        "state_of(self._model, snapshot), self._newest",
        "state_of(self._model, snapshot)._replace(k=snapshot.k + 2), self._newest",
    ),
    Mutant("plans are not kept to be sent again", PLANNED, "self.resend.add(plan.k, (plan,))", "pass"),
    Mutant(
        "a planner keeps tracks that another one has taken",
        PLANNED,
        "self._held.leave(said)",
        "pass",
        only=that_go_on_for_long,
    ),
    Mutant(
        "missing scans are not asked for",
        PLANNED,
        "lacking = {m: self._next_k(m) for m in self._held.all if self._recall.may_ask(m)}",
        "lacking: dict[int, int] = {}",
    ),
    Mutant(
        "a planner that joins never plans in real time",
        PLANNED,
        "if track is not None and track.k > self._newest and",
        "if False and",
        only=in_real_time,
    ),
    Mutant(
        "every plan in real time is seven bins off",
        PLANNED,
        "        if self._model.existence.is_over(state, max(",
        "        if self._pacing.has_deadlines:\n"
        "            seven_off = (decision.bins + 7) % self.radar.array.n_bin\n"
        "            decision = type(decision)(**vars(decision) | {'bins': seven_off})\n"
        "        if self._model.existence.is_over(state, max(",
        only=in_real_time,
    ),
    # Allocator.
    Mutant(
        "the allocator is deaf to plans in real time",
        ALLOCATOR,
        "    run.tracks.note(plan)\n",
        "    if run.pacing.has_deadlines:\n        return ()\n    run.tracks.note(plan)\n",
        only=in_real_time,
    ),
    Mutant(
        "a waveform is made before all plans are there",
        ALLOCATOR,
        "len(plans) >= len(ids) and plans.keys() >= ids",
        "len(plans) >= len(ids) - 1",
    ),
    Mutant(
        "the allocator never hears of orders",
        ALLOCATOR,
        "            run.orders = checkpoint.orders\n",
        "            pass\n",
        only=with_commands,
    ),
    Mutant(
        "the allocator answers twice as late in real time",
        ALLOCATOR,
        "run.due_s, run.wait_s = now_s + run.wait_s, None",
        "run.due_s, run.wait_s = now_s + 20.0 * run.wait_s, None",
        only=in_real_time,
    ),
    # Emulator.
    Mutant(
        "the emulator runs further ahead than it may",
        PACING,
        "return ahead < MAX_AHEAD_DWELLS\n\n    def first_open",
        "return True\n\n    def first_open",
        only=with_commands,
    ),
    Mutant(
        "a repeated waveform replaces the first one",
        EMULATOR,
        "run.waveforms.setdefault(waveform.k, waveform)",
        "run.waveforms[waveform.k] = waveform",
        harmless="what is repeated is the same, byte for byte; what was made of a journal that is no more is dropped",
    ),
    Mutant(
        "the emulator does not recall its last waveform",
        EMULATOR,
        "return (WaveformRecall(run=run.settings.run, k=run.k - 1),) if lacks else ()",
        "return ()",
    ),
    Mutant(
        "an emulator that comes back begins at dwell 0",
        EMULATOR,
        "            k=checkpoint.k,\n            t=checkpoint.t,",
        "            k=0,\n            t=0,",
        missed="in lockstep dwells are the same again, in real time a checkpoint or a waveform says which one is due",
    ),
    Mutant(
        "overdue dwells are made up for in real time",
        PACING,
        "(now_s if now_s >= due_s + self.period_s else due_s) + self.period_s",
        "due_s + self.period_s",
        only=in_real_time,
    ),
    Mutant(
        "a limit of power is not kept by the emulator",
        TRANSMITTED,
        "return limited(transmission(run.radar, waveform), most)",
        "return transmission(run.radar, waveform)",
        only=with_commands,
    ),
    # Delivery.
    Mutant(
        "what is asked for again is sent from the second dwell on",
        RESEND,
        "for dwell in sorted(self._sent) for",
        "for dwell in sorted(self._sent)[1:] for",
    ),
    Mutant(
        "a rewound run is not noticed",
        EPOCHS,
        "return heard.revision > _kept(message.leads, heard.epoch)",
        "return False",
        only=whose_journal_is_put_back,
    ),
    Mutant(
        "what was made of more than the journal has is taken",
        EPOCHS,
        "heard.leads is None or stamp.revision > kept",
        "False",
        only=with_commands_and_a_journal_that_is_put_back,
    ),
    Mutant(
        "a message has the stamp of its sender's last checkpoint, not of what it was made of",
        EPOCHS,
        "        heard.revision = max(heard.revision, stamp.revision)\n",
        "",
        only=with_commands_and_a_journal_that_is_put_back,
        missed="it does harm only to a process that missed each checkpoint of what it passes on",
    ),
    Mutant(
        "what was made under an epoch that the journal does not know is taken",
        EPOCHS,
        "is_known = any(lead.epoch == epoch for lead in leads)",
        "is_known = True",
        only=with_commands_and_a_journal_that_is_put_back,
        missed="the original must come back after an older copy; tests/services/runs/test_rewind.py has such runs",
    ),
    Mutant(
        "a recorder first says how far its runs are when it is asked",
        RECORDER,
        "led_by(self._journal, [answer for run in waiting for answer in run.checkpoint()])",
        "()",
        only=with_commands_and_a_journal_that_is_put_back,
        missed="before its first tick little comes, and most of that is of dwells that it refuses",
    ),
    Mutant(
        "each planner takes another one for the owner",
        PLANNER,
        "[worker for worker in self._workers if worker not in suspended]",
        "[one for one in self._workers if one not in suspended and (one != self._name or len(self._workers) == 1)]",
    ),
    # Pools.
    Mutant(
        "a process of a pool that was frozen goes on before it asks for claims",
        MEMBERS,
        "if (gap_s := now_s - self._looked_s) > PAUSE_S:",
        "if (gap_s := now_s - self._looked_s) > 1e9:",
        only=with_pools,
    ),
    Mutant(
        "of two claims to a shard both stay",
        SHARES,
        "for shard, since_s in earlier.items():",
        "for shard, since_s in {}.items():",
        only=with_pools,
    ),
    Mutant(
        "the tokens of a pool are never looked at again",
        MEMBERS,
        "        if own >= self._shown.keys():\n            others",
        "        if False:\n            others",
        only=with_pools,
    ),
    Mutant(
        "a core is not told of shards that its process has lost",
        MEMBERS,
        "        if self._told == self._shares.held:",
        "        if self._told is not None and self._told >= self._shares.held:",
        only=with_pools,
    ),
    Mutant(
        "claims of a process that is gone are kept",
        SHARES,
        "self._claims = {one: seen for one, seen in self._claims.items() if now_s < seen.absent_s + LEAVE_AFTER_S}",
        "pass",
        only=with_pools,
    ),
    Mutant(
        "claims are taken while the router is away",
        SHARES,
        "if absent and not is_connected():",
        "if absent and is_connected() is None:",
        only=with_pools_and_a_router_that_restarts,
        missed="before it goes on, a process that had no router asks for all claims, and leaves its runs to others",
    ),
    Mutant(
        "a shard is served as soon as it is claimed",
        SHARES,
        "(UNTAKEN_S if shard in rivalled else SETTLE_S)",
        "0.0",
        only=with_pools,
        missed="before it serves a shard a process looks again, and word of other claims has come by then",
    ),
)
