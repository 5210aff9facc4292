"""When the dwells of a run were: one clock for the whole run, ascending."""

from collections.abc import Iterable, Iterator
from itertools import chain
from math import inf
from typing import NamedTuple

from cogradar.services.analysis.arrays.dwell import Dwell

AHEAD = 32  # dwells of a receiver that are held back until one says its time
JUMP = 10.0  # intervals that a time may be away from the expected one


class Timed(NamedTuple):
    """A dwell and its time."""

    at_s: float
    is_utc: bool  # at_s is since 1970 in UTC; else counted from the given epoch
    dwell: Dwell


def timed(dwells: Iterable[Dwell], epoch_s: float = 0.0, acquisition_scans: int | None = None) -> Iterator[Timed]:
    """Dwells with their times, ascending, all of one clock, which is chosen once.

    epoch_s           : when dwell t = 0 is, if neither the front end nor the site says it
    acquisition_scans : dwells up to t = 0, if that is known

    The clock is the front end's if one of the first AHEAD dwells has its time. Dwells before are counted back from it,
    and later ones without a time follow at the interval of the dwells. Else all dwells are counted from the time that
    the site says, or from `epoch_s`. A simulated run has no clock, and none of its dwells is held back.

    A time that is JUMP intervals off is not believed. If the next one is not earlier, the front end's clock has jumped,
    or the run has paused, and all later dwells follow.
    """
    stream, held = iter(dwells), list[Dwell]()
    for dwell in stream:
        held.append(dwell)
        if dwell.utc_s is not None or dwell.scenario.world is not None or len(held) == AHEAD:
            break
    if not held:
        return
    first, told_s, dt_s = held[0], held[-1].utc_s, held[0].scenario.radar.motion.dt_s
    begin_s = None if first.scenario.site is None else first.scenario.site.begin_s
    if told_s is not None:
        from_s = told_s - dt_s * (held[-1].k - first.k)
    else:
        t = first.t or (first.k + 1 - acquisition_scans if acquisition_scans and begin_s is not None else 0)
        from_s = (epoch_s if begin_s is None else begin_s) + dt_s * t
    from_s, from_k = max(from_s, 0.0), first.k  # of the dwell from which others are counted
    at_s, doubted_s = from_s, inf
    for dwell in chain(held, stream):
        last_s, at_s = at_s, from_s + dt_s * (dwell.k - from_k)
        if told_s is not None and dwell.utc_s is not None:
            off_s = dwell.utc_s - at_s
            if abs(off_s) <= JUMP * dt_s or (off_s > 0.0 and dwell.utc_s >= doubted_s):
                at_s, doubted_s = max(dwell.utc_s, last_s), inf
                from_s, from_k = at_s, dwell.k
            else:
                doubted_s = dwell.utc_s if off_s > 0.0 else inf
        yield Timed(at_s, told_s is not None or begin_s is not None, dwell)
