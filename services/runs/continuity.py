"""Whether the tracks of a run in real time went on, whatever became of its processes: read from its journal."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import itemgetter
from typing import NamedTuple

from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import Plan, RunStart, Scan, roster_of
from cogradar.shared.wire.codec import decode


class Span(NamedTuple):
    """Dwells of a run, the last one included, in which something was so."""

    what: str  # "track": it was there, confirmed; "coast": it had no plan; "missed": the dwell did not happen
    track: int | None  # as on the page, counted from 1
    first: int
    last: int


@dataclass(frozen=True)
class Continuity:
    """What became of the tracks of one run."""

    tracks: int  # confirmed at some time
    ended: int  # ... and gone without a plan that says so: no belief ended them, but a process
    longest_coast_s: float  # the longest time without a plan of a confirmed track, by the clock of the dwells
    lost_dwells: int  # numbers of dwells that never happened
    completeness: float | None  # mean share of the targets with a track; None without truth
    spans: Sequence[Span] = ()


def continuity(journal: Journal, start: RunStart, completeness: float | None) -> Continuity:
    """Of a run in real time that is over."""
    planned: dict[int, tuple[int, bool]] = {}  # dwell of the newest plan of a confirmed track, and whether it ends it
    there: dict[int, tuple[int, int]] = {}  # first and last dwell of each track that was confirmed
    ended, dwells, coasts = set[int](), list[int](), list[Span]()
    for k, found in groupby(journal.dwells(start.run, ("plan", "scan")), itemgetter(0)):
        messages = [decode(payload) for _, _, payload in found]
        plans = [message for message in messages if isinstance(message, Plan)]
        scans = [message for message in messages if isinstance(message, Scan) and message.t > 0]
        if not scans:
            continue
        dwells.append(k)
        roster = roster_of(scans[0])
        ids = roster.ids.tolist()
        confirmed = {track for track, is_so in zip(ids, roster.confirmed.tolist(), strict=True) if is_so}
        ended |= {track for track, (_, is_last) in planned.items() if track not in ids and not is_last}
        coasts += _unplanned({track: known for track, known in planned.items() if track not in ids}, there)
        planned = {track: known for track, known in planned.items() if track in ids}
        for plan in plans:
            if plan.target in confirmed or plan.target in planned:  # one that is doubted may end by its belief, too
                last_k, _ = planned.get(plan.target, (k - 1, False))
                if plan.target in confirmed and last_k < k - 1:
                    coasts.append(Span("coast", plan.target + 1, last_k + 1, k - 1))
                planned[plan.target] = (k, plan.status == "ended")
        there |= {track: (there.get(track, (k, k))[0], k) for track in confirmed}
        for track in confirmed:
            planned.setdefault(track, (k, False))
    coasts += _unplanned(planned, there)
    tracks = [Span("track", track + 1, *dwells_of) for track, dwells_of in sorted(there.items())]
    missed = [Span("missed", None, before + 1, after - 1) for before, after in pairwise(dwells) if after > before + 1]
    n_lost = sum(span.last - span.first + 1 for span in missed)
    longest_s = max((span.last - span.first + 1 for span in coasts), default=0) / start.rate_hz
    return Continuity(len(there), len(ended), longest_s, n_lost, completeness, (*tracks, *coasts, *missed))


def _unplanned(planned: dict[int, tuple[int, bool]], there: dict[int, tuple[int, int]]) -> list[Span]:
    """The dwells of tracks from their newest plan to their end."""
    return [
        Span("coast", track + 1, k + 1, there[track][1])
        for track, (k, _) in planned.items()
        if track in there and k < there[track][1]
    ]
