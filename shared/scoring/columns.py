"""The columns of the tables `score` and `picture`, from which store, queries, HTTP, documents and export are made.

A new metric is one file with a function, and one line here.
"""

import json
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from cogradar.shared.scoring.figures import Totals

if TYPE_CHECKING:  # the recorder imports this file and needs no arrays
    import numpy as np
    from numpy.typing import NDArray


class Kind(NamedTuple):
    """The type of a column."""

    sql: str
    python: type
    missing: float = 0  # in arrays and in the export, where SQL has NULL


TEXT, JSON = Kind("TEXT", str), Kind("TEXT", list)
COUNT, BIN, FLAG = Kind("INTEGER", int), Kind("INTEGER", int, -1), Kind("INTEGER", bool)
REAL = Kind("REAL", float, float("nan"))


class Column(NamedTuple):
    """A column of a table."""

    name: str
    kind: Kind
    unit: str
    meaning: str  # no semicolon: it is a comment within a SQL statement
    source: str = ""  # module:function of a TargetDwell or a PictureDwell; "": its attribute of this name
    null: bool = True
    mean: bool = False  # the summary of a run has its mean

    @property
    def sql(self) -> str:
        """Its line in CREATE TABLE."""
        unit = f"[{self.unit}] " if self.unit else ""
        return f"{self.name} {self.kind.sql}{'' if self.null else ' NOT NULL'}, -- {unit}{self.meaning}"


class TargetDwell(NamedTuple):
    """A target in a dwell, of which the columns of `score` are made. None: unknown, or not there."""

    run: str
    k: int
    t: int
    target: int
    track: int | None
    true_bin: int | None
    bin: int | None
    detected: bool | None
    snr_db: float | None
    x: float | None
    vx: float | None
    y: float | None
    vy: float | None
    z: float | None
    x_hat: float | None
    vx_hat: float | None
    y_hat: float | None
    vy_hat: float | None
    covariance: "NDArray[np.float64] | None"  # of the track's belief, (4, 4)
    signature_power: float | None
    late: bool
    stale: bool
    hit: bool | None
    best_bin: int | None
    outage: int | None
    cells: Sequence[tuple[int, float]]
    acceleration_g: float | None
    visible: bool | None

    @property
    def share(self) -> float:
        """Power on the track's beams."""
        return sum(share for _, share in self.cells)


class PictureDwell(NamedTuple):
    """All tracks and targets in a dwell, of which the columns of `picture` are made."""

    run: str
    k: int
    t: int
    tracks: int
    began: int
    tested: int
    blind: int
    unmeasured: int
    waveform_k: int
    late: int
    total: Totals | None  # None without truth

    def __getattr__(self, name: str) -> float | None:
        """What the dwell comes to."""
        if name not in Totals._fields:
            raise AttributeError(name)
        return None if self.total is None else getattr(self.total, name)


SCORE = (
    Column("run", TEXT, "", "its run", null=False),
    Column("k", COUNT, "", "dwell, of all", null=False),
    Column("t", COUNT, "", "dwell, after the acquisition", null=False),
    Column("target", COUNT, "", "number of the target, as in the scenario", null=False),
    Column("track", COUNT, "", "number of the track that follows it, null, as all of its columns, if none does"),
    Column("true_bin", BIN, "", "angle bin that the target was in, from 0, null without truth or if it was not there"),
    Column(
        "bin",
        BIN,
        "",
        "angle bin lit for the track, of several the brightest, from 0, null without track or if none was",
    ),
    Column(
        "detected",
        FLAG,
        "0, 1",
        "a cell that holds it (without truth: of bin) was over the threshold, null: not there, or not measured",
    ),
    Column(
        "snr_db",
        REAL,
        "dB",
        "signal-to-noise ratio per virtual channel, before the array's gain, null as true_bin",
        mean=True,
    ),
    Column("x", REAL, "km", "of the target, null as true_bin, and so are the next four"),
    Column("vx", REAL, "km/s", "of the target"),
    Column("y", REAL, "km", "of the target"),
    Column("vy", REAL, "km/s", "of the target"),
    Column("z", REAL, "km", "its height, 0 unless the scenario gives it one"),
    Column("x_hat", REAL, "km", "mean of the belief after the dwell's scan, null without track"),
    Column("vx_hat", REAL, "km/s", "the same"),
    Column("y_hat", REAL, "km", "the same"),
    Column("vy_hat", REAL, "km/s", "the same"),
    Column(
        "share",
        REAL,
        "power",
        "on the track's beams, linear. All beams together have the array's power",
        null=False,
        mean=True,
    ),
    Column(
        "signature_power",
        REAL,
        "power",
        "of the waveform as the target met it, over all virtual channels, null without truth",
    ),
    Column(
        "late", FLAG, "0, 1", "the track's plan came too late and an older one was extrapolated", null=False, mean=True
    ),
    Column("stale", FLAG, "0, 1", "the waveform came too late and an older one was radiated", null=False, mean=True),
    Column("hit", FLAG, "0, 1", "the true bin, or within half a bin of it, was lit for the track, null without truth"),
    Column(
        "best_bin",
        BIN,
        "",
        "angle bin that was the most probable one before the dwell's scan, from 0, null without track",
    ),
    Column(
        "outage",
        COUNT,
        "dwells",
        "in a row out of the true bin up to this one, null without truth, or if none was begun",
    ),
    Column(
        "nees",
        REAL,
        "",
        "squared error of the estimate over its covariance, 4 on average of an honest belief, null if unknown",
        "cogradar.shared.scoring.errors:nees_of",
    ),
    Column(
        "nees_position",
        REAL,
        "",
        "the same of the position alone, 2 on average of an honest belief",
        "cogradar.shared.scoring.errors:nees_position",
    ),
    Column(
        "nees_velocity",
        REAL,
        "",
        "the same of the velocity alone, 2 on average of an honest belief",
        "cogradar.shared.scoring.errors:nees_velocity",
    ),
    Column(
        "acceleration_g",
        REAL,
        "g",
        "of the target, difference of its velocity since the dwell before over their time, null in its first dwell",
    ),
    Column(
        "visible",
        FLAG,
        "0, 1",
        "a look with all power would have found the target by now with probability one half, null as true_bin",
    ),
    Column(
        "cells",
        JSON,
        "JSON",
        "the cells lit for the track, the brightest first, pairs of angle bin and power",
        null=False,
    ),
)
PICTURE = (
    Column("run", TEXT, "", "its run", null=False),
    Column("k", COUNT, "", "dwell, of all", null=False),
    Column("t", COUNT, "", "dwell, after the acquisition", null=False),
    Column(
        "targets",
        COUNT,
        "",
        "targets that count, as a look with all power would have found them by now, null without truth",
    ),
    Column("tracks", COUNT, "", "tracks, without those assigned to targets that do not count", null=False),
    Column(
        "followed",
        COUNT,
        "",
        "targets with a track within 5 km, one to one, null without truth, and so is all that follows",
    ),
    Column("assigned", COUNT, "", "tracks of these targets, and further ones within 5 km of any target"),
    Column("localisation_km2", REAL, "km^2", "of GOSPA, squared distances of targets and their tracks"),
    Column("missed_km2", REAL, "km^2", "of GOSPA, 12.5 for each target without a track"),
    Column("false_km2", REAL, "km^2", "of GOSPA, 12.5 for each track without a target"),
    Column("ospa_km2", REAL, "km^2", "square of OSPA"),
    Column("swaps", COUNT, "", "tracks that follow another target than before"),
    Column("stretches", COUNT, "", "begun by a track that follows a target from this dwell on"),
    Column("breaks", COUNT, "", "targets whose track follows them no more"),
    Column("confirmed", COUNT, "", "targets that have a track for the first time"),
    Column("confirmed_after", COUNT, "dwells", "from when they counted, in sum"),
    Column("regained", COUNT, "", "targets that have a track again"),
    Column("regained_after", COUNT, "dwells", "that they had none, in sum"),
    Column("began", COUNT, "", "tracks", null=False),
    Column("established", COUNT, "", "tracks that follow a target for the first time"),
    Column("tested", COUNT, "cells", "that the scan reports, where something was sent", null=False),
    Column("blind", COUNT, "cells", "of them, those whose noise has no estimate, their statistic is 0", null=False),
    Column("unmeasured", COUNT, "looks", "that were asked for and that the front end did not measure", null=False),
    Column("waveform_k", COUNT, "", "dwell k whose waveform was radiated, below k - 1 if it is stale", null=False),
    Column("late", COUNT, "tracks", "whose plan came too late and an older one was extrapolated", null=False),
)
_ENCODER = json.JSONEncoder(separators=(",", ":"))
# What answers and arrays have; the power that a target met is for the floor under its error.
SHOWN = tuple(column for column in SCORE if column.name != "signature_power")


def row(columns: Sequence[Column], dwell: TargetDwell | PictureDwell) -> dict[str, Any]:
    """What a dwell comes to, by column."""
    found = {c.name: _load(c.source)(dwell) if c.source else getattr(dwell, c.name) for c in columns}
    if "cells" in found:
        found["cells"] = _ENCODER.encode(found["cells"])
    return found


def definition(columns: Sequence[Column], key: str) -> str:
    """The columns in CREATE TABLE, each with its meaning."""
    return "\n".join(f"    {line}" for line in (*(c.sql for c in columns), f"PRIMARY KEY ({key})"))


@cache
def _load(address: str) -> Any:
    module, _, name = address.partition(":")
    return getattr(import_module(module), name)
