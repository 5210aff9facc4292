"""What must hold of a radar that does not wait for other processes, as far as its faults let it."""

import math
from collections.abc import Collection, Iterable, Sequence
from functools import partial
from itertools import groupby, pairwise
from operator import itemgetter

import numpy as np

from cogradar.services.analysis.replay import CORES, replay
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.simulation.checks.runs import Dwell, Violated
from cogradar.services.simulation.schedule import LINKS, Kind, Schedule
from cogradar.shared.protocol.messages import ABSENT, Message, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE, Role
from cogradar.shared.scenario.combinations import UNKNOWN
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.wire.codec import decode

RECOVERED_S = 5.0  # after the last fault
LEAST_DWELLS = 10  # in which it is looked at
LEAST_IN_TIME, LEAST_P_D = 0.9, 0.5
SLACK = 0.2  # of a period that a dwell may come later than it is due
_SCANS = "SELECT k, payload FROM message WHERE run = ? AND topic = 'scan' ORDER BY k"
FORGETS = frozenset({Kind.CRASH, Kind.LEAVE, Kind.GONE, Kind.MOVED})  # what a process that has them knew


def check_real_time(
    schedule: Schedule,
    journal: Journal,
    starts: Sequence[RunStart],
    radiated: Sequence[Dwell],
    said: Collection[Message],
) -> None:
    """Check these runs of a schedule: what they have radiated, and what was said in them. Raises Violated."""
    faults, takeover_s = schedule.faults, schedule.takeover_s
    at_emulator = [fault for fault in faults if fault.touches(Role.EMULATOR)]
    own_s = max((fault.settled_s for fault in at_emulator), default=0.0)
    # All processes that have the scans of the acquisition lose them: docs/explanation/recovery.md.
    forgets = {fault.who for fault in faults if fault.kind in FORGETS}
    have = [name for name in schedule.names if name.startswith((Role.EMULATOR, Role.PLANNER))]
    all_forget = forgets.issuperset(have) and any(fault.touches(Role.RECORDER) for fault in faults)
    for start in () if schedule.commands else starts:  # a radar that is paused, or has less power, may be blind
        check_pace(start, radiated, own_s + takeover_s)
        if not (all_forget and lacks_acquisition(journal, start)):
            check_recovered(journal, start, schedule.quiet_s - schedule.begins_s + takeover_s)
        if all(Role.PLANNER in fault.who + fault.whom for fault in faults):
            check_in_time(journal, start)
    again = repeated(radiated)
    may_lack_scans = any(fault.touches(Role.RECORDER) for fault in faults)
    if not may_lack_scans and not any(fault.kind in LINKS for fault in at_emulator):
        check_once(again.values())
    if not any(fault.touches(Role.ALLOCATOR) for fault in faults):
        check_begins(said)
    check_replayed(journal, [start for start in starts if start.run not in again])


def check_pace(start: RunStart, radiated: Iterable[Dwell], quiet_s: float) -> None:
    """In real time each dwell is radiated when it is due, whatever happens to others than the emulator.

    Those that could not be are not made up for. Raises Violated.
    """
    period_s = pacing_at(start.rate_hz).seconds(1)
    times = [dwell.at_s for dwell in radiated if dwell.run == start.run]
    for before, after in pairwise(times):
        if before >= quiet_s and after - before > period_s * (1.0 + SLACK):
            raise Violated(f"{start.run}: nothing was radiated from {before:.3f} to {after:.3f} s")
    for before, after in zip(times, times[2:], strict=False):
        if before >= quiet_s and after - before < period_s * (1.0 - SLACK):
            raise Violated(f"{start.run}: three dwells were radiated from {before:.3f} to {after:.3f} s")


def check_recovered(journal: Journal, start: RunStart, quiet_s: float) -> None:
    """In real time plans and waveforms are in time again, some time after the last fault, and targets are seen.

    Raises Violated.
    """
    first_k = math.ceil((quiet_s + RECOVERED_S) * start.rate_hz)
    in_time, fresh, seen = list[bool](), list[bool](), list[bool]()
    for _, of_dwell in groupby(journal.dwells(start.run, ("scan", "truth", "waveform"), from_k=first_k), itemgetter(0)):
        by_type = {type(message): message for message in (decode(payload) for _, _, payload in of_dwell)}
        match by_type.get(Waveform), by_type.get(Scan), by_type.get(Truth):
            case Waveform() | None as sent, Scan() as scan, Truth() as truth:
                in_time += [False] if sent is None else (sent.late == 0).tolist()
                fresh += [scan.waveform_k is None]
                p_fa = float(start.scenario["radar"]["detector"]["p_fa"])
                limits = threshold(p_fa) if scan.limits is None else scan.limits
                bins = np.asarray(scan.bins)[scan.statistic >= limits]
                seen += [bool((np.abs(bins - bin_) <= 1).any()) for bin_ in truth.bins[truth.bins != ABSENT]]
            case _:
                pass
    if len(seen) < LEAST_DWELLS:
        return
    for what, found in (("plans", in_time), ("waveforms", fresh)):
        if (share := float(np.mean(found or [False]))) < LEAST_IN_TIME:
            raise Violated(f"{start.run}: from dwell {first_k} on {share:.0%} of the {what} are in time")
    if np.mean(seen) < LEAST_P_D:
        raise Violated(f"{start.run}: from dwell {first_k} on targets are seen in {np.mean(seen):.0%} of the dwells")


def lacks_acquisition(journal: Journal, start: RunStart) -> bool:
    """Whether a scan of the acquisition is lost, without which a track of a known number cannot begin."""
    scans = [scan for _, payload in journal.rows(_SCANS, [start.run]) if isinstance(scan := decode(payload), Scan)]
    first_k = next((scan.k for scan in scans if scan.t > 0), 0)
    return not _is_unknown(start) and sum(scan.t == 0 for scan in scans) < first_k


def _is_unknown(start: RunStart) -> bool:
    return bool(start.scenario["radar"]["tracks"] == UNKNOWN)


def check_in_time(journal: Journal, start: RunStart) -> None:
    """In real time a waveform does not wait for planners that are away. Raises Violated."""
    scans = (decode(payload) for _, payload in journal.rows(_SCANS, [start.run]))
    late = [scan.k for scan in scans if isinstance(scan, Scan) and scan.t > 1 and scan.waveform_k is not None]
    if late:
        raise Violated(f"{start.run}: only planners were disturbed, and the waveforms of dwells {late} were late")


def repeated(radiated: Iterable[Dwell]) -> dict[str, Dwell]:
    """Of each run in which a dwell was radiated twice the last such one; if it can be, one behind the acquisition.

    What was radiated in the acquisition and not measured is no dwell: the next one has its number.
    """
    known, found = set[tuple[str, int]](), dict[str, Dwell]()
    for dwell in radiated:
        if (dwell.run, dwell.k) in known and (dwell.t > 0 or dwell.run not in found):
            found[dwell.run] = dwell
        if dwell.t > 0 or dwell.is_measured:
            known.add((dwell.run, dwell.k))
    return found


def check_once(dwells: Iterable[Dwell]) -> None:
    """In real time no dwell is repeated once tracks are followed: others know its first scan. Raises Violated."""
    for dwell in dwells:
        if dwell.t > 0:
            raise Violated(f"{dwell.run}: dwell {dwell.k} was radiated twice, the last time at {dwell.at_s:.3f} s")


def check_replayed(journal: Journal, starts: Iterable[RunStart]) -> None:
    """In real time, too, planners and allocator answered as what is journalled makes them answer. Raises Violated.

    Of messages that differ the journal has the first, and counts the others: a process may have used one of those.
    """
    store = Store(journal)
    answered = (
        "SELECT 1 FROM run WHERE run = ? AND conflicts = 0 AND EXISTS (SELECT 1 FROM message AS asked"
        " JOIN message AS made USING (run, k) WHERE asked.run = run.run AND asked.topic IN (?, ?) AND made.topic = ?)"
    )
    for to, (_, fed, kind) in CORES.items():
        for start in starts:
            # After a full disk no dwell may have both. Of a known number the allocator leaves the scans alone.
            topics = [BY_MESSAGE[one].name for one in (fed if _is_unknown(start) else fed[:1])]
            if not journal.rows(answered, [start.run, topics[0], topics[-1], BY_MESSAGE[kind].name]):
                continue
            if (found := replay(StoredRun(partial(answer, store), start.run), to).difference) is not None:
                raise Violated(f"{start.run}: replayed to the {to}, it differs: {found}")


def check_begins(said: Iterable[Message]) -> None:
    """An allocator that nothing has disturbed lets tracks begin. Raises Violated."""
    for message in said:
        if isinstance(message, Waveform) and message.begins_none:
            raise Violated(f"{message.run}: the waveform of dwell {message.k} begins no track")
