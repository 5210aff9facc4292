"""Metrics: answers people's questions about runs, from the journal that the recorder writes on the same file system.

It keeps nothing that it could not read again, so that it may be killed at any time. It sends nothing but commands that
come over HTTP, and takes no time from a run. Checkpoints tell it when there is more to read. Other threads may read its
store.
"""

import json
import logging
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cogradar.services.errors import NoStoreYet, StoreFailed, Unreachable
from cogradar.services.metrics.answers import NO_ROOM, SILENT_S, answer
from cogradar.services.metrics.processes import Gathered
from cogradar.services.metrics.scoring import live
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.address import is_server
from cogradar.services.recorder.store.followed import Followed
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import Checkpoint, Command, Message
from cogradar.shared.wire.meter import Measures
from cogradar.shared.wire.queries import NotNow

FOLLOW_DWELLS = 256  # scored at a checkpoint, some 20 ms: how fast metrics makes up for the past; queries score all
RETRY_S = 1.0  # between two looks whether a server has a journal
COMMANDED_S = 5.0  # for which a command is sent again
MAX_COMMANDS = 100  # that the journal lacks
log = logging.getLogger(__name__)


class MetricsCore:
    """Checkpoints in, commands of others out; answers to queries."""

    def __init__(self, path: str) -> None:
        """Follow the journal in this file, from when it is there on. Raises BadInput if it is something else."""
        self._path, self._followed = path, Followed(path)
        self._open: object | None = None  # the identity of the store that is open
        self._away = ""  # why a server does not answer
        self._retry_s = 0.0  # when it is asked again, if it had no journal
        self.store = in_memory()  # holds no run: there is no journal yet
        self.gather: Callable[[], Gathered] | None = None  # asks all processes; None: there is no router yet
        self.tick_s: float | None = None  # of the last tick
        self._fault = ""  # of the store, that the log has
        self._behind: list[str] = []  # runs of the past that may lack scores
        self._advanced: dict[str, tuple[int, float]] = {}  # durable dwells of runs that go on, and since when
        self._asked: dict[str, tuple[Command, float]] = {}  # commands that the journal lacks, and until when, by id
        self._new: deque[Command] = deque()  # from other threads
        self._reopen()

    @property
    def is_open(self) -> bool:
        """Whether there is a journal."""
        return self._open is not None

    @property
    def trouble(self) -> str:
        """What keeps the journal from being written, as far as it is seen from here; "": nothing."""
        if self._open is None:
            return ""
        if fault := self._away or self._followed.trouble():
            return f"held: {fault}"
        return NO_ROOM if self.store.held else ""

    @property
    def silence(self) -> str:
        """That nothing is heard of the recorder while runs go on; "": something is."""
        heard_s = self.store.heard_s if self._advanced else None
        silent_s = 0.0 if heard_s is None else time.monotonic() - heard_s
        return f"the recorder has said nothing for {silent_s:.0f} s" if silent_s > SILENT_S else ""

    @property
    def has_deferred(self) -> bool:
        """Whether runs of the past have not been scored yet."""
        return bool(self._behind or self._new)

    def command(self, command: Command) -> bool:
        """Send a command to the recorder, again until the journal has it or some seconds are over; from any thread.

        Returns false, and sends nothing, if too many wait.
        """
        if is_free := len(self._new) + len(self._asked) < MAX_COMMANDS:
            self._new.append(command)
        return is_free

    def handle(self, event: Event) -> Sequence[Message]:
        """Score what has become durable, and a piece of the past, so that the next answer has little left to do."""
        fault = self._fault if isinstance(event, Tick) else ""
        for step in (self._follow, self._confirm):
            try:
                step(event)
            except StoreFailed as error:  # no room for scores: they are derived when somebody asks
                if (fault := str(error)) != self._fault:
                    log.error("%s", error)
        self._fault = fault
        return tuple(command for command, _ in self._asked.values()) if isinstance(event, Tick) else ()

    def _confirm(self, event: Event) -> None:
        """Forget the commands that the journal has, or that were sent for long enough."""
        if not isinstance(event, Tick):
            return
        while self._new:
            new = self._new.popleft()
            self._asked[new.id] = new, event.now_s + COMMANDED_S
        for id_, (command, until_s) in list(self._asked.items()):
            query = "SELECT 1 FROM command WHERE run = ? AND id = ?"
            if event.now_s > until_s or self.store.read(query, [command.run, id_]):
                del self._asked[id_]

    def _follow(self, event: Event) -> None:
        match event:
            case Tick():
                self.tick_s = event.now_s
                self._reopen()
                self._look()
                if self._behind and self.store.derive(self._behind[-1:], FOLLOW_DWELLS):
                    self._behind.pop()
            case Checkpoint():
                self.store.heard_s = time.monotonic()
                (self.store.held.add if event.held else self.store.held.discard)(event.run)
                self._note(event)
                self.store.derive([event.run], FOLLOW_DWELLS)
                if event.ended:
                    self.store.forget_dropped()
            case _:
                pass

    def _note(self, checkpoint: Checkpoint) -> None:
        """Note since when a run has had its newest dwell."""
        if checkpoint.ended:
            self._advanced.pop(checkpoint.run, None)
        elif self._advanced.get(checkpoint.run, (-1, 0.0))[0] != checkpoint.k:
            self._advanced[checkpoint.run] = checkpoint.k, time.monotonic()

    def answer(self, metric: str, parameters: Mapping[str, str]) -> bytes:
        """Answer a query with JSON. Raises NotNow while a server does not answer."""
        self._reopen()
        try:
            return json.dumps(answer(self.store, metric, parameters)).encode()
        except Unreachable as error:
            raise NotNow(str(error)) from None

    def measures(self) -> Measures:
        """How many runs there are, what those that go on come to, and how much room they take."""
        self._reopen()
        now_s = time.monotonic()
        own: dict[str, Any] = {
            "dwell_age_seconds": max((now_s - since_s for _, since_s in self._advanced.values()), default=0.0),
            **live.measures(self.store.newest.values()),
        }
        try:
            statuses = self.store.read("SELECT status, COUNT(*) AS n FROM run GROUP BY status")
            (snapshots,) = self.store.read("SELECT COALESCE(SUM(LENGTH(payload)), 0) AS n FROM snapshot")
            n_byte = self.store.journal.n_byte()
        except Unreachable:  # what is not known is not there, rather than nothing at all
            return own
        runs = {row["status"]: row["n"] for row in statuses}
        return own | {"runs": runs, "journal_bytes": n_byte, "snapshot_bytes": snapshots["n"]}

    def close(self) -> None:
        """Close the journal."""
        self.store.close()

    def _reopen(self) -> None:
        """Open the journal if it is there by now, or if another one has been put in its place."""
        if (found := self._followed.identity()) in {None, self._open} or time.monotonic() < self._retry_s:
            return
        try:
            store = Store(Journal(self._path, read_only=True))
        except NoStoreYet as error:
            if is_server(self._path):
                self._retry_s = time.monotonic() + RETRY_S
                if str(error) != self._away:  # a file may be there soon, this may be a mistake
                    self._away = str(error)
                    log.warning("there is no journal yet: %s", error)
            return
        store.heard_s = time.monotonic()
        before, self.store, self._open, self._away = self.store, store, found, ""
        before.close()
        self._behind = [row["run"] for row in store.read("SELECT run FROM run ORDER BY place")]  # the newest first
        log.info("following %s", store.journal.path)

    def _look(self) -> None:
        """Look whether a server answers, once there is a journal. Raises StoreFailed."""
        if self._open is None:
            return
        try:
            self.store.journal.check_place()
        except Unreachable as error:
            self._away = str(error)
            raise
        self._away = ""
