"""The recorder whose journal cannot be written: it holds all runs, says so, and goes on as soon as it can.

The disk is full, the file was removed, replaced or made read-only, the server is away, or what is damaged is no single
run's. If the same file is back, nothing was lost. One in its place lacks what was acknowledged: a recorder that is
started anew begins from it, as from any older journal.

What was not committed when the disk was full is undone, and its sender has kept it. So the recorder ends there, as
if it had been killed, and another one begins where the journal is: the same way back as from any other fault. Runs in
lockstep stand still meanwhile, as nothing is acknowledged. In real time the radar transmits on.
"""

import logging
from collections.abc import Callable, Sequence

from cogradar.services.errors import Damaged, NoRoom
from cogradar.services.recorder.core import MAX_RUNS, RecorderCore, defer, led_by, revised
from cogradar.services.recorder.journal import Journal, Retention, Unreadable
from cogradar.services.recorder.recorded_run import RecordedRun
from cogradar.shared.protocol.events import Event, Membership, Tick
from cogradar.shared.protocol.messages import Checkpoint, Command, Message, Refused, RunCancel, RunStart
from cogradar.shared.wire.meter import Measures

LOOK_TICKS = 4  # between two looks whether there is room again
LEASE_S = 10.0  # of silence, after which a server gives the journal to another recorder
log = logging.getLogger(__name__)


class Recorder:
    """A recorder's core while there is room, and what is said when there is none."""

    def __init__(
        self,
        journal: Journal,
        *,
        resume: bool = False,
        keep: Retention | None = None,
        beside: Callable[[Callable[[], None]], None] = lambda _: None,
    ) -> None:
        """As `RecorderCore` has it; `beside` begins something that may go on while messages are handled."""
        self._beside, self._is_loaded = beside, False
        self._journal, self._resume, self._retention = journal, resume, keep
        self._core: RecorderCore | None = None
        self._ticks = self._looked = 0
        self._trouble = ""
        self._planners: Sequence[str] | None = None
        self._cancelled: dict[str, RunCancel] = {}  # meanwhile, by run
        self._damaged: dict[str, str] = {}  # runs that are to be set aside when it begins, and why
        try:
            journal.expire_after(LEASE_S)  # from the first moment: one that freezes while it begins has it, too
            self._begin()
        except (NoRoom, Damaged) as error:
            self._end(error)

    @property
    def trouble(self) -> str:
        """What it waits for."""
        return f"{self._trouble}; all runs are held" if self._core is None else ""

    @property
    def epoch(self) -> int:
        """With which it leads the runs of its journal; 0: it could not begin yet."""
        return self._journal.epoch

    def lead(self) -> Sequence[Message]:
        """What it says first. Without room nothing, until it can begin."""
        return () if self._core is None else self._core.lead()

    def handle(self, event: Event) -> Sequence[Message]:
        """What the core answers. Without room: that runs are held, until there is some."""
        if isinstance(event, Membership):
            self._planners = event.names
        if self._core is not None:
            self._core.planners = self._planners
        try:
            return self._wait(event) if self._core is None else self._go_on(self._core, event)
        except (NoRoom, Damaged) as error:
            self._end(error)
            self._note(event)
            return self._held()

    def measures(self) -> Measures:
        """How long it took to make rows durable, and whether they can be."""
        return {"commit_seconds": self._journal.commits, "journal_full": int(self._core is None)}

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        if self._core is not None:
            self._core.validate()

    def close(self) -> None:
        """Close the journal."""
        self._journal.close()

    def _go_on(self, core: RecorderCore, event: Event) -> Sequence[Message]:
        if isinstance(event, Tick) and not self._is_loaded and (orders := core.accurate()) is not None:
            self._is_loaded = True
            self._beside(orders.load)  # or the first accuracy would keep all runs waiting for a second
        self._looked += isinstance(event, Tick)
        if isinstance(event, Tick) and self._looked % LOOK_TICKS == 0:
            self._journal.check_leads()
            self._journal.check_place()
            self._journal.expire_after(LEASE_S)
        return core.handle(event)

    def _begin(self) -> RecorderCore:
        """Go on from what is in the journal, without damaged runs. In a file, damage spoils the transaction that meets
        it. So this one is undone, and the run set aside in the next.
        """
        while True:
            try:
                self._core = RecorderCore(self._journal, resume=self._resume, keep=self._retention, aside=self._damaged)
            except Damaged as error:
                if error.run in {"", *self._damaged}:
                    raise
                self._damaged[error.run] = str(error)
                self._journal.rollback()
            else:
                break
        self._damaged.clear()
        self._resume = True  # from now on they are ours
        return self._core

    def _end(self, error: NoRoom | Damaged) -> None:
        if isinstance(error, Damaged) and error.run:
            self._damaged.setdefault(error.run, str(error))
        if self._ticks == 0:
            log.error("%s: all runs are held until it can be written", error)
        self._core, self._trouble = None, str(error)
        self._journal.rollback()

    def _wait(self, event: Event) -> Sequence[Message]:
        """A look now and then whether there is room; if so, on from what is in the journal."""
        if isinstance(event, RunStart | Command):
            raise Refused(self.trouble)
        if isinstance(event, Checkpoint):
            return defer(self._journal, event)
        self._note(event)
        self._ticks += isinstance(event, Tick)
        if not isinstance(event, Tick) or self._ticks % LOOK_TICKS:
            return ()
        self._journal.check_room()
        core = self._begin()
        log.warning("%s: it can be written again", self._journal.path)
        self._ticks, cancelled, self._cancelled = 0, self._cancelled, {}
        ended = [answer for _, cancel in sorted(cancelled.items()) for answer in core.handle(cancel)]
        return [*core.lead(), *ended]

    def _note(self, event: Event) -> None:
        """A client does not repeat its request to cancel a run for ever."""
        if isinstance(event, RunCancel) and len(self._cancelled) < MAX_RUNS:
            self._cancelled.setdefault(event.run, event)

    def _held(self) -> Sequence[Message]:
        """The last checkpoint of each run that goes on, which says why it does not."""
        answers: list[Message] = []
        query = "SELECT run, acknowledged_k AS k, acknowledged_t AS t FROM run WHERE status = 'running' ORDER BY place"
        try:
            rows = self._journal.read(query)
        except (NoRoom, Damaged):  # a server is away: what was granted and is not committed must not be told
            return ()
        for row in rows:
            try:
                if (start := self._journal.start(row["run"])) is None:
                    continue
                run = RecordedRun(start, row["k"], row["t"], self._journal.orders(row["run"]))
                answers += revised(self._journal, run).checkpoint(held=True)
            except (Unreadable, Damaged):
                continue  # it will be set aside
        return led_by(self._journal, answers)
