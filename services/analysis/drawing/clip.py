"""A moving picture of a run: the half-plane before the radar, dwell by dwell, as an animated GIF."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from cogradar.services.analysis.arrays.dwell_range import Dwells, check, is_among
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.drawing.looks import FAINT, INK, STYLE, Look, target_looks
from cogradar.services.errors import BadInput

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TRAIL = 40  # dwells
LEADER_S = 60.0  # of flight, the line before a track
SIZE_INCHES, DPI = (6.4, 3.8), 100
LARGEST = 3000  # dwells of a clip, some 60 MB
RINGS = 5  # of range, at most


class _Tracks(NamedTuple):
    """What is drawn of T dwells and N tracks, announced or not."""

    numbers: list[int]
    states: Floats  # (T, N, 4) km and km/s; NaN where there is no track
    confirmed: Bools  # (T, N)
    detected: Bools  # (T, N)

    @classmethod
    def of(cls, result: Result) -> "_Tracks":
        if not result.scenario.radar.is_unknown:
            states = result.estimates
            known = np.ones(states.shape[:2], dtype=np.bool_)
            return cls(list(range(1, states.shape[1] + 1)), states, known, result.detected)
        tracks = result.by_track
        return cls(tracks.numbers.tolist(), tracks.estimates, tracks.confirmed, tracks.detections)


def write(result: Result, file: Path, dwells: Dwells, rate_hz: float, report: Callable[[int], None]) -> int:
    """Draw dwells t, first and last, None: of the run, into a GIF, `rate_hz` of them a second; returns how many.

    `report` is told how many were drawn. Raises BadInput if there is none of these dwells, or too many.
    """
    check(result, (dwells[0] or 1, dwells[1]))
    chosen = np.flatnonzero(is_among(result.t, dwells))
    if chosen.size > LARGEST:
        raise BadInput(f"{chosen.size} dwells: a clip has {LARGEST} at most; --dwells A:B chooses some")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE_INCHES, layout="tight")
        axes, writer = figure.add_subplot(), PillowWriter(fps=max(1, round(rate_hz)))
        with writer.saving(figure, str(file), DPI):
            scope = Scope(result, chosen.tolist())
            for n, i in enumerate(chosen.tolist(), start=1):
                axes.clear()
                scope.draw(axes, i)
                writer.grab_frame()
                report(n)
    return int(chosen.size)


class Scope:
    """A run on a scope, dwell by dwell."""

    def __init__(self, result: Result, shown: Sequence[int]) -> None:
        """shown : rows of the dwells that are to be on it; range rings fit them all"""
        self._result, self._tracks = result, _Tracks.of(result)
        self._truth = result.true_states[..., [0, 2]] if result.has_truth else None
        places = [self._tracks.states[shown][..., [0, 2]].reshape(-1, 2)]
        places += [self._truth[shown].reshape(-1, 2)] if self._truth is not None else []
        far = np.hypot(*np.concatenate(places).T)
        farthest_km = float(np.max(far, where=~np.isnan(far), initial=1.0))
        self._rings_km = np.asarray(MaxNLocator(RINGS).tick_values(0.0, farthest_km))[1:]
        numbers = self._tracks.numbers
        self._looks = dict(zip(numbers, target_looks(len(numbers)), strict=True))

    def draw(self, axes: Axes, i: int) -> None:
        """Draw the dwell in row i, with its title."""
        tracks = self._tracks
        _rings(axes, self._rings_km)
        if self._truth is not None:
            there = self._truth[i][~np.isnan(self._truth[i, :, 0])]
            axes.plot(there[:, 1], there[:, 0], "+", color=INK, markersize=9, markeredgewidth=0.8)
        for n, number in enumerate(tracks.numbers):
            if not np.isnan(tracks.states[i, n, 0]):
                _track(axes, tracks, (i, n), self._looks[number])
        alive = ~np.isnan(tracks.states[i, :, 0])
        kind = "confirmed tracks" if self._result.scenario.radar.is_unknown else "tracks"
        count = int((alive & tracks.confirmed[i]).sum())
        title = f"{self._result.scenario.name}, dwell {self._result.t[i]}: {count} {kind}"
        axes.set_title(title, loc="left", color=INK)


def _rings(axes: Axes, rings_km: Floats) -> None:
    """Range rings and angles; x points up, y to the right."""
    angles, far_km = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 181), float(rings_km[-1])
    for km in rings_km.tolist():
        axes.plot(km * np.sin(angles), km * np.cos(angles), color="#cccccc", linewidth=0.6)
        axes.annotate(f"{km:g} km", (km, 0.0), (0, -9), textcoords="offset points", ha="center", color=FAINT, size=7)
    for angle in np.radians([-60.0, -30.0, 0.0, 30.0, 60.0]):
        axes.plot([0.0, far_km * np.sin(angle)], [0.0, far_km * np.cos(angle)], color="#dddddd", linewidth=0.5)
    axes.set(xlim=(-1.04 * far_km, 1.04 * far_km), ylim=(-0.05 * far_km, 1.04 * far_km), aspect="equal")
    axes.set_axis_off()


def _track(axes: Axes, tracks: _Tracks, at: tuple[int, int], look: Look) -> None:
    """A track with its trail and a minute of flight: filled if it was detected, dashed while it is tentative."""
    i, n = at
    x, vx, y, vy = tracks.states[i, n].tolist()
    is_confirmed = bool(tracks.confirmed[i, n])
    trail = tracks.states[max(0, i - TRAIL) : i + 1, n]
    axes.plot(trail[:, 2], trail[:, 0], color=look.colour, linewidth=1.0, alpha=0.5)
    ahead = [y, y + LEADER_S * vy], [x, x + LEADER_S * vx]
    axes.plot(*ahead, color=look.colour, linewidth=0.9, linestyle="-" if is_confirmed else ":")
    fill = look.colour if tracks.detected[i, n] and is_confirmed else "white"
    axes.plot(y, x, "o", color=look.colour, markerfacecolor=fill, markersize=5 if is_confirmed else 3.5)
    if is_confirmed:
        number = str(tracks.numbers[n])
        axes.annotate(number, (y, x), (5, 4), textcoords="offset points", color=look.colour, size=8, weight="bold")
