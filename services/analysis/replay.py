"""A stored run fed into one core: does it answer today as it was recorded, bit for bit?

A planner takes up tracks as in the run, with a clock that stands still: no search is cut short. The allocator gets the
clock of lockstep. For a run in real time this leaves out what depended on the clock. Of searches that a deadline cut
short it leaves out the bin and the number of simulations. It leaves out waveforms of dwells without all plans in time,
after a scan of an older roster, or of an allocator that has just come back. Tracks coast over a dwell without a scan,
as they did in the run. A plan says which scans its belief went without (`Plan.unseen`): it is left out where the
journal has other scans.

A run without an end may have lost its oldest dwells. The tracks that began in them are left out: a track is a function
of the scans since its birth.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.errors import BadInput
from cogradar.services.planner.core import PlannerCore
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Scan, Waveform, roster_of
from cogradar.shared.protocol.orders import DropTrack, Order, in_force, of_tracks
from cogradar.shared.protocol.recovery import History
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.scenario.plugins.resolver import load_for
from cogradar.shared.scenario.tables import TRUE_RULES
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.wire.runner import Core

REPLAY = "replay"  # name of the planner
ACKNOWLEDGE_EVERY = 64  # dwells, so that a core keeps no more than in a run
OF_THE_CLOCK = {"bins", "nus", "chances", "gain", "n_sim"}  # fields of a plan that depend on when its search ended


# What each core is fed, and what it answers. Of a known number of tracks the allocator leaves the scans alone.
CORES: dict[str, tuple[Callable[[], Core], tuple[type[Scan | Plan], ...], type[Plan | Waveform]]] = {
    "planner": (lambda: PlannerCore(REPLAY, lambda: 0.0), (Scan,), Plan),
    "allocator": (AllocatorCore, (Plan, Scan), Waveform),
}


@dataclass(frozen=True)
class Difference:
    """Where an answer differs first."""

    k: int  # dwell, of all
    t: int  # after the acquisition; 0 during it
    track: int | None  # counted from 1; None: all together
    field: str
    recorded: str
    now: str


@dataclass(frozen=True)
class Replay:
    """What came of it."""

    agreed: int  # messages that are the same, up to the difference
    difference: Difference | None = None
    cut_short: int = 0  # plans of which bin and n_sim were not compared
    late: int = 0  # waveforms that were not compared
    missing: int = 0  # dwells without a scan, over which tracks coasted
    skipped: int = 0  # ... that never happened, as the next scan says
    other_scans: int = 0  # plans that were not compared: their planner had not the scans of the journal
    cut_off: int = 0  # ... of tracks that began in dwells that were cut
    conflicts: int = 0  # messages of the run that differed from the first of their kind, which the journal has


def replay(stored: StoredRun, to: str, report: Callable[[int], None] = lambda _: None) -> Replay:
    """Feed a run into a core until an answer differs. `report` is told how many dwells were fed.

    Raises BadInput if the store lacks what the core needs, as a campaign's store does; PluginError if something of a
    user's own cannot be loaded with the source that the run had.
    """
    first = _checked(stored, to)
    make, fed, compared = CORES[to]
    core, by_clock = make(), pacing_at(stored.start.rate_hz).loses_dwells
    topics = [BY_MESSAGE[message].name for message in (*fed, compared)]
    rate_hz = stored.start.rate_hz if by_clock and to == "planner" else 0.0
    core.handle(_checkpoint(stored, first, 0, rate_hz=rate_hz))
    outcome, t = Replay(0, conflicts=stored.row["conflicts"]), 0
    cut_off: set[int] | None = None  # tracks that began before the first dwell; None: no scan has said it yet
    given, told, acknowledged = stored.orders() if to == "allocator" else [], list[Order](), (first, 0)
    before: Sequence[Message] = ()  # recorded answers of the dwell before
    next_k, lost_k = first, -1  # after the newest scan; the newest dwell without one
    for n_fed, (k, payloads) in enumerate(stored.messages(*topics)):
        messages = [decode(payload) for payload in payloads]
        inputs = [message for message in messages if isinstance(message, fed)]
        if to == "allocator" and not by_clock and not _has_plans(inputs):
            raise BadInput(f"{stored.name}: scan or plans of dwell {k} are not stored, as in the store of a campaign")
        t = max((message.t for message in inputs), default=t)
        if given and (obeyed := _obeyed(given, messages, k + 1, by_clock=by_clock)) != told:
            told = obeyed
            core.handle(_checkpoint(stored, *acknowledged, told))
        if rate_hz and inputs and k > next_k:
            outcome, lost_k = _without_scans(outcome, inputs[0], k - next_k), k - 1
            core.handle(_checkpoint(stored, k, t, rate_hz=rate_hz))
            core.handle(History(run=stored.name, to=REPLAY, topic="scan", k=next_k, payloads=[encode(inputs[0])]))
        next_k = k + 1 if inputs else next_k
        answers = [answer for message in inputs for answer in core.handle(message) if isinstance(answer, compared)]
        if rate_hz:  # what is rebuilt between two dwells
            answers += [answer for answer in core.handle(Tick(k / rate_hz)) if isinstance(answer, compared)]
        recorded: Sequence[Message] = [message for message in messages if isinstance(message, compared)]
        cut_off = _begun_before(first, inputs) if cut_off is None else cut_off
        outcome, recorded = _of_others(outcome, recorded, cut_off or set())
        if rate_hz:
            outcome, recorded = _of_these_scans(outcome, recorded, inputs, answers, lost_k)
        # In real time the allocator goes on from the roster that it sent last, where a scan has an older one.
        is_stale = by_clock and to == "allocator" and k > first and _rosters(inputs) != _rosters(before)
        outcome = _compared(outcome, recorded, [] if is_stale else answers, (k, t), by_clock=by_clock)
        before = recorded
        report(n_fed + 1)
        if outcome.difference is not None:
            return outcome
        if (k + 1) % ACKNOWLEDGE_EVERY == 0:
            acknowledged = k + 1, t
            core.handle(_checkpoint(stored, *acknowledged, told, rate_hz=rate_hz))
    _check_begun(stored, outcome, t, f"{topics[0]} and {topics[-1]}")
    return outcome


def _checked(stored: StoredRun, to: str) -> int:
    """The first dwell of a run that is kept. Raises BadInput if the core cannot be fed with it, PluginError."""
    if to not in CORES:
        raise BadInput(f"to = {to!r}: must be one of {', '.join(CORES)}")
    rule = stored.scenario.radar.planner.rule
    if to == "planner" and rule in TRUE_RULES:
        raise BadInput(f"{stored.name}: its policy, {rule}, knows the truth, which a planner alone does not")
    load_for(to, stored.start.scenario["radar"], stored.start.strategy)
    first = int(stored.row["kept_k"])
    if first > 0 and to == "planner" and not stored.scenario.radar.is_unknown:
        raise BadInput(
            f"{stored.name}: its first {first} dwells were cut, and all its tracks began in them; COGRADAR_KEEP_BYTES"
            " and COGRADAR_KEEP_HOURS of the recorder say how much is kept"
        )
    return first


def _check_begun(stored: StoredRun, outcome: Replay, t: int, topics: str) -> None:
    """Raises BadInput if nothing was compared, unless nothing was found: there was nothing to plan."""
    if outcome.cut_off and not outcome.agreed:
        raise BadInput(
            f"{stored.name}: all tracks that it has began in dwells that were cut: there is nothing to compare"
        )
    is_empty = stored.scenario.radar.is_unknown and t > 0
    if not outcome.agreed and not outcome.late and not outcome.other_scans and not is_empty:
        raise BadInput(f"{stored.name}: no dwell has {topics} stored, as in the store of a campaign")


def _obeyed(given: Sequence[Order], messages: Sequence[Message], k: int, *, by_clock: bool) -> list[Order]:
    """The orders that shape dwell k; of a run in real time those that its waveform says, which may have come late."""
    if by_clock:
        said = next((one.orders for one in messages if isinstance(one, Waveform)), None)
        numbers = set() if said is None else set(said.tolist())
        return [one.model_copy(update={"k": min(one.k, k)}) for one in given if one.n in numbers]
    dropping = [one for one in given if one.k == k and isinstance(one.action, DropTrack)]
    rosters = _rosters([one for one in messages if isinstance(one, Scan)])
    born_ks = dict(zip(rosters[0].ids.tolist(), rosters[0].born_k.tolist(), strict=True)) if rosters else None
    return [*of_tracks(in_force(given, k), born_ks), *dropping]  # without the births of all earlier tracks


def _without_scans(outcome: Replay, scan: Message, n: int) -> Replay:
    """The outcome with so many more dwells before a scan that have none."""
    skipped = (scan.skipped or 0) if isinstance(scan, Scan) else 0
    return replace(outcome, missing=outcome.missing + n, skipped=outcome.skipped + min(skipped, n))


def _begun_before(first: int, inputs: Sequence[Message]) -> set[int] | None:
    """The tracks of a scan that began before the one of the first dwell; None without a scan."""
    begun = [zip(one.ids.tolist(), one.born_k.tolist(), strict=True) for one in _rosters(inputs)]
    return {m for one in begun for m, k in one if k < first - 1} if inputs else None


def _of_others(outcome: Replay, recorded: Sequence[Message], cut_off: set[int]) -> tuple[Replay, Sequence[Message]]:
    """The outcome with the plans of these tracks counted, and what was recorded without them."""
    found = [one for one in recorded if not (isinstance(one, Plan) and one.target in cut_off)]
    return replace(outcome, cut_off=outcome.cut_off + len(recorded) - len(found)), found


def _of_these_scans(
    outcome: Replay, recorded: Sequence[Message], inputs: Sequence[Message], answers: Sequence[Message], lost_k: int
) -> tuple[Replay, Sequence[Message]]:
    """The outcome with the other plans counted, and the recorded plans whose beliefs had the scans of the journal.

    lost_k : newest dwell without a scan in the journal; a track that began before it may have begun in that scan
    """
    unseen = {answer.target: answer.unseen for answer in answers if isinstance(answer, Plan)}
    rosters = [roster_of(scan) for scan in inputs if isinstance(scan, Scan)]
    old = {m for one in rosters for m, k in zip(one.ids.tolist(), one.born_k.tolist(), strict=True) if k <= lost_k}
    found = [
        plan
        for plan in recorded
        if isinstance(plan, Plan)
        and inputs
        and (plan.unseen == unseen[plan.target] if plan.target in unseen else plan.target not in old)
    ]
    return replace(outcome, other_scans=outcome.other_scans + len(recorded) - len(found)), found


def _rosters(messages: Sequence[Message]) -> list[Roster]:
    """The rosters of scans and waveforms, of an unknown number of tracks."""
    return [one.roster for one in messages if isinstance(one, Scan | Waveform) and one.roster is not None]


def _has_plans(inputs: Sequence[Message]) -> bool:
    """Whether the scan of a dwell and the plans of all its tracks are among these messages."""
    planned = {message.target for message in inputs if isinstance(message, Plan)}
    rosters = [roster_of(message) for message in inputs if isinstance(message, Scan)]
    return bool(rosters) and planned >= set(rosters[0].ids.tolist())


def words(run: str, to: str, outcome: Replay) -> list[str]:
    """What came of it, as lines for people."""
    kind = BY_MESSAGE[CORES[to][2]].name
    agreed = f"{outcome.agreed} {kind}s agree bit for bit"
    notes = []
    if outcome.cut_short:
        notes.append(f"{outcome.cut_short} searches were cut short by the clock: their bin and n_sim were not compared")
    if outcome.late:
        notes.append(
            f"{outcome.late} waveforms were not compared: their plans, or the waveforms before them, were late,"
            " or their allocator had just come back"
        )
    if outcome.missing:
        skipped = f", {outcome.skipped} never happened" if outcome.skipped else ""
        notes.append(f"{outcome.missing} dwells have no scan{skipped}: tracks coasted over them")
    if outcome.other_scans:
        notes.append(f"{outcome.other_scans} plans were not compared: their planner had other scans than the journal")
    if outcome.cut_off:
        notes.append(f"{outcome.cut_off} plans were not compared: their tracks began in dwells that were cut")
    if (found := outcome.difference) is None:
        return [f"{run}: {agreed}", *notes]
    if outcome.conflicts:
        notes.append(
            f"{outcome.conflicts} messages of this run were sent again with other contents: the journal has the first"
            " of each, and a process may have used another one"
        )
    whose = "" if found.track is None else f" of track {found.track}"
    where = f"dwell k = {found.k} (t = {found.t})"
    return [
        f"{run}: the {kind}{whose} at {where} differs: {found.field} was {found.recorded}, is {found.now}",
        f"{agreed} before it",
        *notes,
    ]


def _checkpoint(stored: StoredRun, k: int, t: int, orders: Sequence[Order] = (), rate_hz: float = 0.0) -> Checkpoint:
    """What the recorder tells a core, in lockstep."""
    start = stored.start
    return Checkpoint(
        run=start.run,
        strategy=start.strategy,
        dwells=start.dwells,
        radar=start.scenario["radar"],
        seed=radar_seed(start.seed),
        k=k,
        t=t,
        orders=list(orders),
        rate_hz=rate_hz,
    )


def _compared(
    outcome: Replay, recorded: Sequence[Message], answers: Sequence[Message], dwell: tuple[int, int], *, by_clock: bool
) -> Replay:
    """The outcome after one more dwell (k, t), by track."""
    found = {getattr(answer, "target", None): answer for answer in answers}
    for message in recorded:
        target = getattr(message, "target", None)
        answer, track = found.get(target), None if target is None else target + 1
        if by_clock and isinstance(message, Waveform) and (answer is None or message.late.any() or message.begins_none):
            outcome = replace(outcome, late=outcome.late + 1)
            continue
        if answer is None:
            return replace(outcome, difference=Difference(*dwell, track, "message", "one", "none"))
        is_cut = by_clock and isinstance(message, Plan) and isinstance(answer, Plan) and message.n_sim < answer.n_sim
        for name in type(message).model_fields:
            if is_cut and name in OF_THE_CLOCK:
                continue
            if (texts := _difference(getattr(message, name), getattr(answer, name))) is not None:
                place, was, now = texts
                return replace(outcome, difference=Difference(*dwell, track, name + place, was, now))
        outcome = replace(outcome, agreed=outcome.agreed + 1, cut_short=outcome.cut_short + is_cut)
    return outcome


def _difference(was: Any, now: Any) -> tuple[str, str, str] | None:
    """Where two values differ, and both there; None if they are the same bit for bit."""
    if not isinstance(was, np.ndarray):
        return None if repr(was) == repr(now) else ("", str(was), str(now))
    if was.shape != now.shape or was.dtype != now.dtype:
        return ".shape", f"{was.shape} of {was.dtype}", f"{now.shape} of {now.dtype}"
    as_bytes = [np.ascontiguousarray(array).reshape(-1, 1).view(np.uint8) for array in (was, now)]
    differs = (as_bytes[0] != as_bytes[1]).any(axis=1)
    if not differs.any():
        return None
    place = np.unravel_index(int(differs.argmax()), was.shape)
    return f"[{', '.join(map(str, place))}]", str(was[place].item()), str(now[place].item())
