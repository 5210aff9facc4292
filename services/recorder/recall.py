"""What the journal gives back to a process that lacks it."""

import itertools
from collections.abc import Iterable, Iterator
from typing import Literal

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.fields import MAX_HISTORY
from cogradar.shared.protocol.recovery import History, ScanRecall, WaveformRecall
from cogradar.shared.protocol.topics import Role

RECALL_BYTES = 1 << 20  # of one History
_Topic = Literal["scan", "plan", "waveform", "snapshot"]
_Journalled = tuple[int, list[bytes]]  # dwell of the first, and what was encoded


def recalled(journal: Journal, recall: ScanRecall | WaveformRecall) -> list[History]:
    """What is asked for; of a track its snapshot, and the scans only if some track has none that helps.

    Raises Damaged.
    """
    run, first = recall.run, recall.k
    rates = journal.read("SELECT rate_hz FROM run WHERE run = ?", [run])
    loses_dwells = any(pacing_at(row["rate_hz"]).loses_dwells for row in rates)
    if isinstance(recall, WaveformRecall):  # allocator and planners resend the later ones
        found = _messages(journal, run, "waveform", first, 1)
        if not found and loses_dwells:
            found = _newest_waveform(journal, run, first)
        return _addressed(run, Role.EMULATOR, "waveform", found)
    kept = [journal.snapshot(run, target + 1, first) for target in recall.targets]
    snapshots = [(k, [payload]) for k, payload in filter(None, kept)]
    scans = _messages(journal, run, "scan", first, MAX_HISTORY, has_gaps=loses_dwells) if None in kept else []
    asker = recall.planner
    return [*_addressed(run, asker, "snapshot", snapshots), *_addressed(run, asker, "scan", scans)]


def plans_of(journal: Journal, run: str, k: int) -> list[History]:
    """The plans of a dwell for the allocator, which may lack one that no planner is left to send again.

    Raises Damaged.
    """
    payloads = journal.messages(run, ["plan"], k, k + 1)
    return _addressed(run, Role.ALLOCATOR, "plan", ((k, part) for part in _parts(payloads)))


def _parts(payloads: Iterator[bytes]) -> Iterator[list[bytes]]:
    """As many at a time as a History has."""
    while part := list(itertools.islice(payloads, MAX_HISTORY)):
        yield part


def _addressed(run: str, to: str, topic: _Topic, found: Iterable[_Journalled]) -> list[History]:
    """To the one who asked: the others would have to decode what they do not need."""
    return [History(run=run, to=to, topic=topic, k=k, payloads=payloads) for k, payloads in found]


def _newest_waveform(journal: Journal, run: str, before: int) -> list[_Journalled]:
    """In real time any waveform will do for a front end that comes back: the newest there is before a dwell."""
    rows = journal.stored(
        "message", "WHERE run = ? AND topic = 'waveform' AND k < ? ORDER BY k DESC LIMIT 1", [run, before]
    )
    return [(row["k"], [row["payload"]]) for row in rows]


def _messages(
    journal: Journal, run: str, topic: _Topic, first: int, most: int, *, has_gaps: bool = False
) -> list[_Journalled]:
    """Stored messages from a dwell on, as many as fit into one answer; unless it `has_gaps`, only those before one."""
    payloads: list[bytes] = []
    which = "WHERE run = ? AND topic = ? AND k >= ? ORDER BY k LIMIT ?"
    rows = journal.stored("message", which, [run, topic, first, most])
    for k, row in enumerate(rows, first):
        if (row["k"] != k and not has_gaps) or sum(map(len, payloads)) > RECALL_BYTES:
            break
        payloads.append(row["payload"])
    return [(first, payloads)] if payloads else []
