"""Whether the tracks of a run in real time went on, whatever became of its processes: read from its journal."""

from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import Plan, RunStart, Scan, roster_of
from cogradar.shared.wire.codec import decode


@dataclass(frozen=True)
class Continuity:
    """What became of the tracks of one run."""

    tracks: int  # confirmed at some time
    ended: int  # ... and gone without a plan that says so: no belief ended them, but a process
    longest_coast_s: float  # the longest time without a plan of a confirmed track, by the clock of the dwells
    lost_dwells: int  # numbers of dwells that never happened
    completeness: float | None  # mean share of the targets with a track; None without truth


def continuity(journal: Journal, start: RunStart, completeness: float | None) -> Continuity:
    """Of a run in real time that is over."""
    planned: dict[int, tuple[int, bool]] = {}  # dwell of the newest plan of a confirmed track, and whether it ends it
    seen, ended = set[int](), set[int]()
    longest, dwells = 0, list[int]()
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
        planned = {track: known for track, known in planned.items() if track in ids}
        for plan in plans:
            if plan.target in confirmed or plan.target in planned:  # one that is doubted may end by its belief, too
                last_k, _ = planned.get(plan.target, (k - 1, False))
                longest = max(longest, k - last_k - 1) if plan.target in confirmed else longest
                planned[plan.target] = (k, plan.status == "ended")
        for track in confirmed:
            longest = max(longest, k - planned.setdefault(track, (k, False))[0])
        seen |= confirmed
    lost = dwells[-1] - dwells[0] + 1 - len(dwells) if dwells else 0
    period_s = 1.0 / start.rate_hz
    return Continuity(len(seen), len(ended), longest * period_s, lost, completeness)
