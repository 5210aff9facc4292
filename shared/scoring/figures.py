"""What the air picture comes to over a run (`cogradar.shared.scoring.picture`); read by those who load no SciPy."""

from collections.abc import Sequence
from math import ceil, inf, sqrt
from typing import NamedTuple, Self

CUT_OFF_KM = 5.0  # c: a track that is further off follows no target
LONG_VISIBLE = 20  # dwells; a target that was visible for so long without a confirmed track was never found


class Totals(NamedTuple):
    """What a dwell comes to, or many: everything is summed. Of targets those are meant that count."""

    dwells: int
    targets: int  # J
    tracks: int  # N, without those assigned to targets that do not count
    followed: int  # J_T, targets with a track
    assigned: int  # N_A, tracks of these targets, and further ones within the gate of any of them
    localisation_km2: float  # (`cogradar.shared.scoring.sets.SetDistance`), as are the next three
    missed_km2: float
    false_km2: float
    ospa_km2: float
    swaps: int  # a track has become the track of another target: has followed it in three dwells in a row
    stretches: int  # begun: dwells in a row in which one track follows a target
    breaks: int  # stretches that ended while their target was there
    confirmed: int  # targets followed for the first time,
    confirmed_after: int  # ... and the dwells that this took from when they counted
    regained: int  # targets followed again, by whatever track,
    regained_after: int  # ... and the dwells without a track of them
    began: int  # tracks
    established: int  # tracks that have come to follow a first target; tracks that never do are false


class Figures(NamedTuple):
    """What a run comes to; None: of nothing."""

    tracks: int
    gospa_km: float  # root mean square over dwells; the squares of the next three add up to its square
    gospa_localisation_km: float
    gospa_missed_km: float
    gospa_false_km: float
    ospa_km: float
    completeness: float | None
    ambiguity: float | None
    spuriousness: float | None
    swaps: int
    breaks: int
    track_life_s: float | None
    confirmation_s: float | None
    reacquisition_s: float | None
    false_tracks: int
    false_tracks_per_hour: float

    @classmethod
    def of(cls, total: Totals, dt_s: float) -> Self:
        """Figures of the dwells that were summed, one at least, each of so many seconds.

            completeness = sum J_T / sum J,  ambiguity = sum N_A / sum J_T,  spuriousness = sum (N - N_A) / sum N

        over dwells (Votruba et al. 2001). Track life: mean length of a stretch. Times to confirmation and to
        re-acquisition: means over the targets that were, and over the gaps that were closed.
        """
        n, false_tracks = total.dwells, total.began - total.established
        gospa = total.localisation_km2 + total.missed_km2 + total.false_km2
        return cls(
            total.began,
            sqrt(gospa / n),
            sqrt(total.localisation_km2 / n),
            sqrt(total.missed_km2 / n),
            sqrt(total.false_km2 / n),
            sqrt(total.ospa_km2 / n),
            _ratio(total.followed, total.targets),
            _ratio(total.assigned, total.followed),
            _ratio(total.tracks - total.assigned, total.tracks),
            total.swaps,
            total.breaks,
            _ratio(dt_s * total.followed, total.stretches),
            _ratio(dt_s * total.confirmed_after, total.confirmed),
            _ratio(dt_s * total.regained_after, total.regained),
            false_tracks,
            false_tracks * 3600.0 / (n * dt_s),
        )


class Discovery(NamedTuple):
    """How soon visible targets got a confirmed track, over targets and runs; None: of nothing."""

    targets: int  # visible in one dwell at least
    confirmed: int  # of them, those that a confirmed track has followed
    confirmation_median_s: float | None  # from visible to confirmed
    confirmation_95_s: float | None  # 95 % of the targets did not wait longer
    long_visible: int  # targets visible in LONG_VISIBLE dwells or more
    never_found: int  # of them, those without a confirmed track

    @classmethod
    def of(cls, targets: Sequence[tuple[int, int | None, int, float]]) -> Self:
        """Of targets: the first dwell in which each was visible and confirmed, visible dwells, and s of a dwell.

        A target that was confirmed before it was visible waited for nothing. One that was never found counts as a wait
        without an end. One that was visible for fewer than LONG_VISIBLE dwells, and not confirmed, is in no quantile.
        """
        waits = sorted(dt_s * max(0, found - seen) for seen, found, _, dt_s in targets if found is not None)
        long_visible = sum(n >= LONG_VISIBLE for _, _, n, _ in targets)
        never_found = sum(n >= LONG_VISIBLE and found is None for _, found, n, _ in targets)
        all_waits = [*waits, *(never_found * [inf])]
        median, most = (_quantile(all_waits, q) for q in (0.5, 0.95))
        return cls(len(targets), len(waits), median, most, long_visible, never_found)


def _quantile(values: Sequence[float], q: float) -> float | None:
    """The least of the ascending values that is not below a share q of them; None: there is none, or it is infinite."""
    value = values[ceil(q * len(values)) - 1] if values else inf
    return None if value == inf else value


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None
