"""What the runs that go on come to in their newest dwells: numbers for an operator's display and its alarms."""

from collections.abc import Iterable, Sequence
from math import nan, sqrt

from cogradar.services.metrics.scoring.scorer import Scored
from cogradar.shared.scoring.errors import LOST_WINDOW
from cogradar.shared.wire.meter import Measures

_PARTS = ("localisation_km2", "missed_km2", "false_km2")


def measures(newest: Iterable[Scored]) -> Measures:
    """The newest dwells of all runs together; NaN is what needs truth, or targets, where no run has them."""
    dwells = list(newest)
    pictures = [dwell.picture for dwell in dwells]
    judged = [picture for picture in pictures if picture["targets"] is not None]
    there = [bool(row["detected"]) for dwell in dwells for row in dwell.targets if row["detected"] is not None]
    tested = sum(picture["tested"] for picture in pictures)
    return {
        "tracks": sum(picture["tracks"] for picture in pictures),
        "targets": sum(picture["targets"] for picture in judged) if judged else nan,
        "tracks_false": sum(picture["tracks"] - picture["assigned"] for picture in judged) if judged else nan,
        "targets_missed": sum(picture["targets"] - picture["followed"] for picture in judged) if judged else nan,
        "tracks_lost": sum(
            row["outage"] is not None and row["outage"] >= min(LOST_WINDOW, dwell.t)
            for dwell in dwells
            for row in dwell.targets
        ),
        "detected_share": _mean(there),
        "gospa_km": _mean([sqrt(sum(picture[part] for part in _PARTS)) for picture in judged]),
        "blind_share": sum(picture["blind"] for picture in pictures) / tested if tested else nan,
    }


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else nan
