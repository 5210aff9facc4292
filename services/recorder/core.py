"""Recorder: journals every message, says by checkpoints how far each run is durable, recalls what others do not keep.

It leads: every process that comes late or comes back begins where the last checkpoint says. A checkpoint is sent only
after the transaction that it acknowledges is committed, so that not even a power cut takes an acknowledgement back.
"""

import logging
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from cogradar.services.delivery.invariant import require
from cogradar.services.delivery.order_book import FOR_END, URGENT_COMMANDS, OrderBook, commands_kept_free
from cogradar.services.delivery.pending import Pending
from cogradar.services.errors import Damaged
from cogradar.services.recorder.damaged_runs import set_aside
from cogradar.services.recorder.journal import Journal, Retention, Unreadable
from cogradar.services.recorder.kept_span import KeptSpan
from cogradar.services.recorder.recall import plans_of, recalled
from cogradar.services.recorder.recorded_run import OfDwell, RecordedRun
from cogradar.services.recorder.store.check import check_count, check_row
from cogradar.services.recorder.store.database import deposed
from cogradar.services.recorder.store.tables import MAX_COMMANDS
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import (
    MAX_REASON,
    Checkpoint,
    Command,
    Message,
    Plan,
    Refused,
    RunCancel,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from cogradar.shared.protocol.orders import in_force
from cogradar.shared.protocol.recovery import NoPlans, NoWaveforms, ScanRecall, Snapshot, WaveformRecall
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.protocol.words.orders import text_of
from cogradar.shared.wire.codec import BadMessage, decode, encode

CHECKPOINT_DWELLS = 16  # a checkpoint after so many complete dwells; far below what its readers keep to redeliver,
COMMIT_TICKS = 2  # ... and after so many ticks with uncommitted rows, less than half a second
BEHIND_TICKS = 8  # ticks without an empty inbox that count as one
RECALLED_BYTES = 32 << 20  # of all recalls between two ticks; a process that asked in vain asks again
MOST_COUNTED = 200_000  # messages at the end of a run, some 30 ms; `cogradar store check` counts any number
MAX_RUNS = 4096  # that go on at a time
_NONE: Mapping[str, str] = MappingProxyType({})
_OF_DWELL = ("scan", "truth", "plan", "waveform")
log = logging.getLogger(__name__)


def led_by(journal: Journal, answers: Sequence[Message]) -> Sequence[Message]:
    """The answers of the recorder that has this journal, with its epoch."""
    return [answer.model_copy(update={"epoch": journal.epoch}) for answer in answers] if answers else answers


def revised(journal: Journal, run: RecordedRun) -> RecordedRun:
    """The run with its revision, and those with which the last epochs began, before it goes on."""
    run.n_command, *_ = journal.commands(run.start.run, "")
    run.leads = journal.leads(run.start.run, run.revision)
    return run


def defer(journal: Journal, heard: Checkpoint) -> Sequence[Message]:
    """Raise Deposed if a checkpoint is of a recorder that began after the one that has this journal."""
    if heard.epoch > journal.epoch:
        journal.rollback()
        raise deposed(journal.epoch, heard.epoch, f"another recorder leads {heard.run}")
    return ()


class RecorderCore:
    """Messages in, rows into the journal, checkpoints out. Only the journal, which is handed in, touches a file.

    It can raise NoRoom, and is of no use then: `cogradar.services.recorder.full_disk`.
    """

    def __init__(
        self, journal: Journal, *, resume: bool = False, keep: Retention | None = None, aside: Mapping[str, str] = _NONE
    ) -> None:
        """With `resume`, unfinished runs of the journal go on; else they are marked as interrupted.

        aside : runs that are damaged, and what is said of each
        """
        self._journal, self._retention = journal, keep or Retention()
        self.planners: Sequence[str] | None = None  # that are there, as far as this process is told
        self._runs: dict[str, RecordedRun] = {}
        self._spans: dict[str, KeptSpan] = {}  # of the same runs
        self._pending = Pending()
        self._recalled = 0  # bytes, in this tick
        self._notified: set[str] = set()  # ended runs whose last checkpoint was repeated in this tick
        self._uncommitted_ticks = self._behind_ticks = 0
        journal.lead()
        for name, reason in set_aside(journal):
            log.error("%s is set aside: %s", name, reason)
        for name, reason in aside.items():
            self._set_aside(name, reason)
        if resume:
            for run in journal.unfinished():
                self._resume(run)
        else:
            journal.give_up_unfinished()
        journal.drop_ended(self._retention)
        journal.commit()

    def lead(self) -> Sequence[Message]:
        """What it says first: how far each run in lockstep is in its journal. What was made of more is void."""
        waiting = [run for run in self._runs.values() if not run.pacing.loses_dwells]
        return led_by(self._journal, [answer for run in waiting for answer in run.checkpoint()])

    def handle(self, event: Event) -> Sequence[Message]:
        """Journal a message; a checkpoint if enough is complete, a History if something is recalled. Raises Deposed."""
        try:
            answers = self._answers(event)
        except Damaged as error:
            if not error.run:
                raise  # the store as a whole, whatever run came upon it
            told = self._end_damaged(error.run, error)
            answers = [*self._commit(), *told]
        return led_by(self._journal, answers)

    def _answers(self, event: Event) -> Sequence[Message]:
        match event:
            case RunStart():
                answers = self._begin(event)
            case Scan() | Truth() | Plan() | Waveform() | Snapshot():
                answers = self._take(event)
            case RunEnd() | RunCancel():
                answers = self._end(event if isinstance(event, RunEnd) else self._cancelled(event))
            case Command():
                answers = self._command(event)
            case NoPlans() | NoWaveforms():
                answers = self._hindered(event)
            case ScanRecall() | WaveformRecall():
                answers = self._recall(event) if self._knows(event.run) else ()
            case Tick():
                answers = self._tick(event)
            case Checkpoint():
                answers = defer(self._journal, event)
            case _:
                answers = ()
        return answers

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        self._pending.validate()
        rows = self._journal.rows("SELECT run, acknowledged_k, acknowledged_t FROM run WHERE status = 'running'")
        require({row[0] for row in rows} == self._runs.keys(), "other runs go on than the journal says")
        for name, *acknowledged in rows:
            self._runs[name].validate(tuple(acknowledged))

    def accurate(self) -> OrderBook | None:
        """The orders of a run that may be asked for accuracies, if one goes on."""
        return next((run.orders for run in self._runs.values() if run.orders.takes_accuracies), None)

    def _knows(self, run: str) -> bool:
        return bool(self._journal.read("SELECT 1 FROM run WHERE run = ?", [run]))

    def _resume(self, name: str) -> None:
        """Go on with a run from its last checkpoint; set it aside if it cannot be read, for the sake of the others."""
        try:
            with self._journal.part():
                self._runs[name] = self._resumed(name)
                self._journal.hinder(name, "")  # what still cannot do its part says so again
        except (Unreadable, BadMessage, Damaged) as error:
            self._set_aside(name, str(error))
        else:
            log.info("going on with %s from dwell %d", name, self._runs[name].k)

    def _set_aside(self, name: str, reason: str) -> None:
        for known in (self._runs, self._spans):
            known.pop(name, None)
        self._journal.quarantine(name, reason)
        log.error("%s cannot go on and is set aside: %s", name, reason)

    def _end_damaged(self, name: str, error: Damaged | Unreadable) -> list[Checkpoint]:
        """Set a run aside whose rows cannot be used; its processes are told that it is over, once that is durable."""
        run = self._runs.get(name)
        self._set_aside(name, str(error))
        return [] if run is None else run.checkpoint(ended=True)

    def _resumed(self, name: str) -> RecordedRun:
        start = self._journal.start(name)
        if start is None:
            raise Unreadable("no such run")
        row = check_row(self._journal, name)
        k, t = row["acknowledged_k"], row["acknowledged_t"]
        run = revised(self._journal, RecordedRun(start, k, t, self._journal.orders(name), resumed=True))
        self._journal.set_leads(name, run.leads)
        run.n_message = row["messages"]
        for target in self._journal.snapshot_ks(name):
            self._journal.snapshot(name, target, 0)  # if it cannot be read, the next one cannot replace it
        span = self._spans[name] = KeptSpan.of(start, self._retention)
        span.reopen(self._journal, row)
        for payload in self._journal.messages(name, _OF_DWELL, from_k=run.k):
            message = decode(payload)
            if isinstance(message, OfDwell):
                run.take(message)
        while run.is_ready():
            run.complete()
        return run

    def _begin(self, start: RunStart) -> Sequence[Message]:
        if self._knows(start.run):
            known = self._start_of(start.run)
            if known is None:  # it is set aside
                return RecordedRun(start).checkpoint(ended=True)
            if known != start:
                raise Refused("another run has this name")
            return () if start.run in self._runs else self._repeat_end(start.run)
        if len(self._runs) >= MAX_RUNS:
            raise Refused(f"{MAX_RUNS} runs go on, which is all there can be at a time")
        run = self._runs[start.run] = RecordedRun(start)
        self._journal.add_run(start)
        run.leads = self._journal.leads(start.run, run.revision)
        self._journal.set_leads(start.run, run.leads)
        self._spans[start.run] = KeptSpan.of(start, self._retention)
        return [*self._commit(), *run.checkpoint(), *self._pending.replay(start.run, self.handle)]

    def _start_of(self, run: str) -> RunStart | None:
        """How a run of the journal began; None if there is none, or none that can be read."""
        try:
            return self._journal.start(run)
        except (Unreadable, Damaged):
            return None

    def _end(self, end: RunEnd) -> Sequence[Message]:
        if (run := self._runs.get(end.run)) is not None:
            # The first one counts, as of all messages: an emulator that comes back after the end skips to another one.
            if run.end is None or end.status != "complete":
                run.end = end
            return self._advance(run)
        if not self._knows(end.run):
            self._pending.add(end)
        return self._repeat_end(end.run)

    def _repeat_end(self, run: str) -> Sequence[Message]:
        """The last checkpoint of a run, which got lost; nothing if no such run is known."""
        start = self._start_of(run)
        return () if start is None else RecordedRun(start).checkpoint(ended=True)

    def _cancelled(self, cancel: RunCancel) -> RunEnd:
        """The end of a run as it is. One that is not known yet ends when it begins."""
        known = self._runs.get(cancel.run)
        k, t = (max(known.k - 1, 0), known.t) if known is not None else (0, 0)
        return RunEnd(run=cancel.run, k=k, t=t, status="stopped", reason=cancel.reason)

    def _hindered(self, by: NoPlans | NoWaveforms) -> Sequence[Message]:
        """A process cannot do its part of a run: end it, or say in the journal what it waits for."""
        if (run := self._runs.get(by.run)) is None or run.end is not None:
            return ()
        names_others = isinstance(by, NoPlans) and by.late
        reason = by.reason if names_others else f"{by.process}: {by.reason}"[:MAX_REASON]
        if by.ends:
            end = {"run": by.run, "k": max(run.k - 1, 0), "t": run.t, "status": "failed", "reason": reason}
            return self._end(RunEnd.model_validate(end))
        if run.hinder(by.process, reason):
            self._journal.hinder(by.run, run.hindrances)
        return ()

    def _command(self, command: Command) -> Sequence[Message]:
        """Grant a command, or refuse it, and say so in the journal; the order is durable before anybody hears of it."""
        if (run := self._runs.get(command.run)) is None:
            raise Refused("no such run goes on")
        last, count, is_known = self._journal.commands(command.run, command.id)
        if is_known:
            return ()
        if count >= MAX_COMMANDS - commands_kept_free(command):
            raise Refused(f"{count} commands of this run are in the journal, which is all there can be")
        answers: list[Message] = [*self._commit()]
        try:
            order, replaced = run.grant(command, last + 1)
        except Refused as refusal:
            log.warning("%s: %s, by %s, is refused: %s", command.run, text_of(command.action), command.by, refusal)
            if count >= MAX_COMMANDS - FOR_END - URGENT_COMMANDS:
                raise  # what is kept free is for what is granted
            self._journal.add_command(command, last + 1, None, str(refusal))
            self._journal.commit()
            run.n_command = last + 1
            return answers
        log.info("%s: %s, by %s, from dwell %d on", command.run, text_of(command.action), command.by, order.k)
        self._journal.add_command(command, order.n, order.k, "")
        for other in replaced:
            self._journal.end_order(command.run, other.n, other.k)
        self._journal.commit()
        run.n_command = order.n
        return [*answers, *run.checkpoint()]

    def _take(self, message: OfDwell | Snapshot) -> Sequence[Message]:
        if (run := self._runs.get(message.run)) is None:
            return self._take_of_other(message)
        run.check(message)
        if isinstance(message, Snapshot):
            self._keep(run, message)
            return ()
        item = message.target + 1 if isinstance(message, Plan) else 0
        topic, payload = BY_MESSAGE[type(message)].name, encode(message)
        is_open = message.k >= run.k  # what comes after its dwell was completed without it, in real time, is too late
        if is_open and self._journal.add_message(message.run, message.k, topic, item, payload):
            run.take(message)
            self._spans[message.run].n_byte += len(payload)
            return self._advance(run)
        if self._journal.message(message.run, message.k, topic, item) not in {None, payload}:
            self._journal.add_conflict(message.run)
            raise Refused(f"{topic} of dwell {message.k} differs from the one that came first")
        return ()

    def _take_of_other(self, message: OfDwell | Snapshot) -> Sequence[Message]:
        """Keep a message of a run that is not known yet. A sender in a run that is over has missed its end."""
        if not self._knows(message.run):
            if not isinstance(message, Snapshot):
                self._pending.add(message)
            return ()
        if not isinstance(message, Scan) or message.run in self._notified:
            return ()
        self._notified.add(message.run)
        return self._repeat_end(message.run)

    def _keep(self, run: RecordedRun, snapshot: Snapshot) -> None:
        """Keep what a track was, unless a dwell up to then is incomplete: what goes on from it plans none of them."""
        if snapshot.k >= run.acknowledged[0]:
            raise Refused(f"snapshot of dwell {snapshot.k}, only those before {run.acknowledged[0]} are acknowledged")
        self._journal.set_snapshot(snapshot.run, snapshot.target + 1, snapshot.k, encode(snapshot))

    def _recall(self, recall: ScanRecall | WaveformRecall) -> Sequence[Message]:
        """What is asked for, unless much has been asked for in this tick: a short question may have a long answer."""
        if self._recalled >= RECALLED_BYTES:
            raise Refused(f"{self._recalled >> 20} MiB were recalled in this tick already")
        answers = recalled(self._journal, recall)
        self._recalled += sum(len(payload) for answer in answers for payload in answer.payloads)
        return answers

    def _advance(self, run: RecordedRun) -> Sequence[Message]:
        """Complete what is there; a checkpoint now and then, and at the end."""
        try:
            if run.forgive():
                self._journal.hinder(run.start.run, run.hindrances)
            while run.is_ready():
                run.complete()
                run.digest.advance(self._journal, run.k)
            if run.end is not None and run.is_over:
                # The digest of a part of a run is not needed.
                span = self._spans[run.start.run]
                is_part = run.end.status == "stopped" or span.first_k > 0
                while not (is_part or span.is_counted):
                    span.count(self._journal, run.start.run)
                return self._finish(run, run.end, "" if is_part else self._digest(run))
        except (Unreadable, Damaged) as error:
            told = self._end_damaged(run.start.run, error)
            return [*self._commit(), *told]
        return self._commit() if run.k >= run.acknowledged[0] + CHECKPOINT_DWELLS else ()

    def _digest(self, run: RecordedRun) -> str:
        """Of all messages, which are complete by now. Raises Unreadable, Damaged."""
        if run.n_message <= MOST_COUNTED:
            check_count(self._journal, run.start.run, run.k, run.n_message)
        return run.digest.finish(self._journal)

    def _finish(self, run: RecordedRun, end: RunEnd, digest: str) -> Sequence[Message]:
        if there := in_force(run.orders.orders, run.k):
            names = ", ".join(text_of(order.action) for order in there)
            log.warning("%s ends, and with it its orders: %s; the next run begins without any", run.start.run, names)
        with self._journal.part():
            self._journal.acknowledge(run.start.run, run.k, run.t, run.n_message)
            self._journal.end_run(end, digest)
        del self._runs[run.start.run], self._spans[run.start.run]
        others = self._commit()
        run.acknowledged = run.k, run.t
        return [*others, *run.checkpoint(ended=True)]

    def _commit(self) -> list[Checkpoint]:
        """Make durable what is written; only then the checkpoints of the runs in which more is complete than before."""
        advanced, told = [run for run in self._runs.values() if run.k > run.acknowledged[0]], list[Checkpoint]()
        for run in list(advanced):
            try:
                with self._journal.part():
                    self._note_progress(run)
            except Damaged as error:
                advanced.remove(run)
                told += self._end_damaged(run.start.run, error)
        self._journal.commit()
        self._uncommitted_ticks = 0
        for run in advanced:
            run.acknowledged = run.k, run.t
        return [*told, *(checkpoint for run in advanced for checkpoint in run.checkpoint())]

    def _note_progress(self, run: RecordedRun) -> None:
        """Write how far a run is complete, and what this ends. Raises Damaged."""
        self._journal.acknowledge(run.start.run, run.k, run.t, run.n_message)
        if run.tracks is not None:  # ended tracks are not continued
            self._journal.drop_snapshots(run.start.run, [track + 1 for track in run.tracks])
        self._spans[run.start.run].cut(self._journal, run)
        for n in run.orders.end(run.k, run.known_k, run.born_ks):
            self._journal.end_order(run.start.run, n, run.k)

    def _tick(self, tick: Tick) -> Sequence[Message]:
        self._behind_ticks = 0 if tick.drained else (self._behind_ticks + 1) % BEHIND_TICKS
        if self._behind_ticks:  # what seems to be missing may be in the queue: hardly any time passes for the runs
            return self._commit() if self._has_waited() else ()
        self._notified.clear()
        self._recalled = 0
        answers: list[Message] = []
        going_on = {name for name, run in self._runs.items() if run.has_news and not run.pacing.has_deadlines}
        for name, run in list(self._runs.items()):
            run.tick(others_go_on=bool(going_on - {name}) and tick.drained)
            is_known = run.lacks_plans  # under overload the tracks change with each tick
            if self.planners is not None and run.hinder_overdue(self.planners):
                log.log(logging.DEBUG if is_known else logging.WARNING, "%s: %s", name, run.hindrances)
                self._journal.hinder(name, run.hindrances)
            answers += self._advance(run)
        self._journal.drop_ended(self._retention)
        self._journal.delete_dropped()
        answers += self._count_some()
        if self._has_waited():
            answers += self._commit()
        return [*answers, *self._repeated()]

    def _count_some(self) -> Sequence[Message]:
        """Go on counting the messages of a long run that was reopened, which is set aside if some are missing."""
        for name in [name for name, span in self._spans.items() if not span.is_counted][:1]:
            try:
                self._spans[name].count(self._journal, name)
            except Damaged as error:
                told = self._end_damaged(name, error)
                return [*self._commit(), *told]
        return ()

    def _has_waited(self) -> bool:
        """Whether rows have been uncommitted for long enough, after one more tick."""
        self._uncommitted_ticks += self._journal.has_uncommitted
        return self._uncommitted_ticks >= COMMIT_TICKS

    def _repeated(self) -> list[Message]:
        """Checkpoints of the runs that stand still: they ask for what is missing, and tell new processes of the run."""
        asking = [run for run in self._runs.values() if run.wants_resend or run.wants_repeat or run.has_overdue]
        waiting = {run: run.wants_resend for run in asking}
        if not waiting:
            return []
        answers: list[Message] = [*self._commit()]
        for run, resend in waiting.items():
            plans = plans_of(self._journal, run.start.run, run.k) if resend and run.awaits_waveform else []
            answers += [*run.checkpoint(resend=resend), *plans]
        return answers
