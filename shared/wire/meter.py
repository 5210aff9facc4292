"""What a process counts of itself for Prometheus: messages that pass, the time they take, what dwells come to.

While it works it counts in plain numbers, some 3 us an event; text is made when somebody asks, by
`cogradar.shared.wire.exposition`, which says what each number means. No run and no target is ever a key: they have no
bound. Types are compared with `is`: to ask whether a message is an instance takes 600 ns.
"""

import time
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol, runtime_checkable

import numpy as np

from cogradar.shared.protocol.events import Event
from cogradar.shared.protocol.messages import Checkpoint, EmulatorCheckpoint, Message, Plan, Scan, Truth, Waveform
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.protocol.topics import TOPICS, Role, topics_read_by

# Upper edges of the histograms: 100 us is a message that is only kept, 10 s a search to the letter for many targets.
EDGES_S = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
# Of what a dwell comes to: ten in each power of ten, so that 100 ms and 125 ms are told apart.
FINE_EDGES_S = (*(float(f"{m}e{e}") for e in range(-4, 1) for m in (1, 1.25, 1.6, 2, 2.5, 3.2, 4, 5, 6.3, 8)), 10.0)
RESENT = {Scan, Truth, Plan, Waveform}  # what is sent again until it is acknowledged
MAX_KEPT = 10_000  # of what is kept per run: no process is sure to hear of every run's end


class Durations:
    """A histogram of seconds."""

    def __init__(self, edges_s: tuple[float, ...] = EDGES_S) -> None:
        self.edges_s = edges_s
        self.counts = [0] * (len(edges_s) + 1)  # the last: beyond the last edge
        self.sum_s = 0.0

    def observe(self, seconds: float) -> None:
        """Count one."""
        self.counts[bisect_left(self.edges_s, seconds)] += 1
        self.sum_s += seconds

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Count what is done meanwhile, unless it fails."""
        began = time.monotonic()
        yield
        self.observe(time.monotonic() - began)


Value = float | Durations
Measures = Mapping[str, Value | Mapping[str, Value]]  # by name; with a label, by its value


@runtime_checkable
class Measured(Protocol):
    """A core that knows more about itself than what passes."""

    def measures(self) -> Measures:
        """That, within a millisecond: the next event waits for it."""


class Meter:
    """The counters of one process, for the thread that calls `receive`."""

    def __init__(self, role: Role) -> None:
        self._sent = defaultdict(_Passed, {topic.message: _Passed() for topic in TOPICS if topic.producer is role})
        self._received = defaultdict(_Passed, {topic.message: _Passed() for topic in topics_read_by(role)})
        self._newest: dict[tuple[str, type[Any], int], int] = {}  # dwell that was sent last
        self._handled: defaultdict[type[Any], Durations] = defaultdict(Durations)
        self._begun_s = 0.0  # when the event was begun that is handled now
        self._queries: defaultdict[str, Durations] = defaultdict(Durations)
        self._dwells = _DWELLS.get(role, _Dwells)()

    def receive(self, messages: list[Message], n_byte: int) -> None:
        """Count the messages of a payload, all of one topic."""
        passed = self._received[type(messages[0])]
        passed.n += len(messages)
        passed.n_byte += n_byte

    def take(self, message: Message, arrived_s: float) -> None:
        """Note a message that is handled next."""
        self._dwells.take(message, arrived_s)

    def begin(self) -> None:
        """Note that an event is handled from now on."""
        self._begun_s = time.monotonic()

    def end(self, event: Event) -> None:
        """Count an event that is handled, and its answers sent."""
        self._handled[type(event)].observe(time.monotonic() - self._begun_s)

    def send(self, message: Message, n_byte: int) -> None:
        """Count a message that went out."""
        kind: type[Any] = type(message)
        passed = self._sent[kind]
        passed.n += 1
        passed.n_byte += n_byte
        if kind in RESENT:
            k: int = getattr(message, "k", 0)
            item = (message.run, kind, getattr(message, "target", 0) if kind is Plan else 0)
            if self._newest.get(item, -1) >= k:
                passed.n_again += 1
            else:
                _keep(self._newest, item, k)
        self._dwells.send(message, self._begun_s)

    def answer(self, status: str, seconds: float) -> None:
        """Count a query, and how long its answer took."""
        self._queries[status].observe(seconds)

    def measures(self) -> Measures:
        """All that was counted, and what the role's dwells came to."""
        return {
            "messages_sent": {_name(kind): passed.n for kind, passed in self._sent.items()},
            "messages_received": {_name(kind): passed.n for kind, passed in self._received.items()},
            "sent_bytes": {_name(kind): passed.n_byte for kind, passed in self._sent.items()},
            "received_bytes": {_name(kind): passed.n_byte for kind, passed in self._received.items()},
            "messages_redelivered": {
                _name(kind): passed.n_again for kind, passed in self._sent.items() if kind in RESENT
            },
            "handling_seconds": {_name(kind): durations for kind, durations in self._handled.items()},
            "query_seconds": self._queries,
            **self._dwells.measures(),
        }


class _Passed:
    """Messages of one topic, one way."""

    __slots__ = ("n", "n_again", "n_byte")

    def __init__(self) -> None:
        self.n = self.n_byte = self.n_again = 0


class _Dwells:
    """What a role sees of dwells: nothing."""

    def take(self, message: Message, arrived_s: float) -> None:
        pass

    def send(self, message: Message, begun_s: float) -> None:
        pass

    def measures(self) -> Measures:
        return {}


class _Transmitted(_Dwells):
    """The emulator's: when each was transmitted, and with which waveform."""

    def __init__(self) -> None:
        self._is_real_time: dict[str, bool] = {}
        self._waveforms: dict[str, tuple[int, float]] = {}  # the newest of a run: its dwell, and when it came
        self._scans: dict[str, tuple[int, float]] = {}  # ... and the dwell that was transmitted last
        self._duration, self._margin, self._n_stale = Durations(FINE_EDGES_S), Durations(FINE_EDGES_S), 0
        self._measuring = Durations(FINE_EDGES_S)

    def take(self, message: Message, arrived_s: float) -> None:
        if type(message) is Waveform:
            if self._waveforms.get(message.run, (-1, 0.0))[0] < message.k:  # one that comes again came before
                _keep(self._waveforms, message.run, (message.k, arrived_s))
        elif type(message) is EmulatorCheckpoint:
            _keep(self._is_real_time, message.run, message.rate_hz > 0.0)

    def send(self, message: Message, begun_s: float) -> None:
        if type(message) is not Scan:
            return
        k, last_s = self._scans.get(message.run, (-1, 0.0))
        if message.k <= k:
            return  # sent again
        if message.k == k + 1 > 0:
            self._duration.observe(begun_s - last_s)
        _keep(self._scans, message.run, (message.k, begun_s))
        if message.t > 0 and self._is_real_time.get(message.run, False):
            self._measuring.observe(time.monotonic() - begun_s)
            waveform_k, arrived_s = self._waveforms.get(message.run, (-1, 0.0))
            if waveform_k == message.k - 1:
                self._margin.observe(begun_s - arrived_s)
            else:
                self._n_stale += 1

    def measures(self) -> Measures:
        return {
            "dwell_seconds": self._duration,
            "deadline_margin_seconds": self._margin,
            "scan_seconds": self._measuring,
            "waveforms_stale": self._n_stale,
        }


class _Answered(_Dwells):
    """The allocator's: the plans that a waveform could not wait for, and confirmed tracks that ended."""

    def __init__(self) -> None:
        self._n_late = self._n_ended = 0
        self._confirmed: dict[str, tuple[int, set[int]]] = {}  # newest dwell of a run, and its tracks

    def send(self, message: Message, begun_s: float) -> None:  # noqa: ARG002 - of the others
        if type(message) is Waveform:
            self._n_late += int(np.count_nonzero(message.late))
            if message.roster is not None:
                self._count_ended(message.run, message.k, message.roster)

    def _count_ended(self, run: str, k: int, roster: Roster) -> None:
        before, tracks = self._confirmed.get(run, (-1, set[int]()))
        if k <= before:
            return  # sent again
        self._n_ended += len(tracks.difference(roster.ids.tolist()))
        _keep(self._confirmed, run, (k, set(roster.ids[roster.confirmed == 1].tolist())))

    def measures(self) -> Measures:
        return {"plans_late": self._n_late, "tracks_ended": self._n_ended}


class _Acknowledged(_Dwells):
    """The recorder's: how many are durable."""

    def __init__(self) -> None:
        self._k: dict[str, int] = {}
        self._n = 0

    def send(self, message: Message, begun_s: float) -> None:  # noqa: ARG002 - of the others
        if type(message) is Checkpoint:  # the emulator's says the same
            self._n += max(0, message.k - self._k.get(message.run, message.k))
            _keep(self._k, message.run, message.k)

    def measures(self) -> Measures:
        return {"dwells": self._n}


_DWELLS: dict[Role, type[_Dwells]] = {
    Role.EMULATOR: _Transmitted,
    Role.ALLOCATOR: _Answered,
    Role.RECORDER: _Acknowledged,
}


def _keep(kept: dict[Any, Any], key: Any, value: Any) -> None:
    """Keep a value; the one that was kept first makes room for a new key."""
    if key not in kept and len(kept) >= MAX_KEPT:
        del kept[next(iter(kept))]
    kept[key] = value


def _name(kind: type[Any]) -> str:
    """Of a topic, or of what else a core is handed."""
    return kind.__name__.lower()
