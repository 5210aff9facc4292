"""Pictures of one run, for notebooks: each draws into axes that are given, or into new ones, and returns them."""

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from cogradar.services.analysis.drawing.clip import Scope
from cogradar.services.analysis.drawing.looks import DASHED, FAINT, STYLE, target_looks
from cogradar.services.errors import BadInput
from cogradar.shared.signal.waveform import beampattern

if TYPE_CHECKING:
    from cogradar.services.analysis.arrays.result import Result

DIRECTIONS = 8001  # of a beam pattern: the main lobe of 100 antennas is 160 of them wide


class RunPlots:
    """Pictures of one run."""

    def __init__(self, result: "Result") -> None:
        self._result = result

    def __repr__(self) -> str:
        return f"<pictures of {self._result.run}: .scope(dwell), .track(target), .beampattern(dwell)>"

    def scope(self, dwell: int, axes: Axes | None = None) -> Axes:
        """Tracks and targets after a dwell, counted from 1: boresight is up.

        Raises BadInput if there is no such dwell.
        """
        at = self._at(dwell)
        with mpl.rc_context(STYLE):
            axes = _new(axes)
            Scope(self._result, [at]).draw(axes, at)
        return axes

    def track(self, target: int, axes: Axes | None = None) -> Axes:
        """Path of a target, counted from 1, and of the track that follows it, in km.

        Raises BadInput if there is no such target.
        """
        result = self._result
        if not 1 <= target <= result.scenario.n_target:
            raise BadInput(f"target = {target}: must be 1 .. {result.scenario.n_target}")
        look = target_looks(result.scenario.n_target)[target - 1]
        with mpl.rc_context(STYLE):
            axes = _new(axes)
            if result.has_truth:
                path = result.true_states[:, target - 1]
                axes.plot(path[:, 0], path[:, 2], color=FAINT, linewidth=1.5, label=f"target {target}")
            found, hits = result.estimates[:, target - 1], result.detected[:, target - 1]
            axes.plot(found[:, 0], found[:, 2], color=look.colour, linestyle=DASHED, label="estimate")
            axes.plot(found[hits, 0], found[hits, 2], ".", color=look.colour, markersize=3, label="detected")
            axes.set(xlabel="x (boresight), km", ylabel="y, km", title=f"{result.scenario.name}, target {target}")
            axes.legend()
        return axes

    def beampattern(self, dwell: int, axes: Axes | None = None) -> Axes:
        """Power that a dwell, counted from 1, sent in each direction, in dB, and where the targets were.

        Raises BadInput if there is no such dwell, or its waveform is not stored.
        """
        result, at = self._result, self._at(dwell)
        nus = np.linspace(-0.5, 0.5, DIRECTIONS)
        power = beampattern(float(result.isotropic[at]), result.factors[at], nus)
        with mpl.rc_context(STYLE):
            axes = _new(axes)
            axes.plot(np.degrees(np.arcsin(2.0 * nus)), 10.0 * np.log10(np.maximum(power, 1e-12)))
            if result.has_truth:
                x, y = result.true_states[at, :, 0], result.true_states[at, :, 2]
                for angle in np.degrees(np.arctan2(y, x))[~np.isnan(x)].tolist():
                    axes.axvline(angle, color=FAINT, linewidth=0.8, zorder=0)
            axes.set(xlabel="angle from boresight, degrees", ylabel="$a^T R a^*$, dB", xlim=(-90.0, 90.0))
            axes.set_title(f"{result.scenario.name}, dwell {dwell}", loc="left")
        return axes

    def _at(self, dwell: int) -> int:
        """Row of a dwell. Raises BadInput."""
        t = self._result.t
        (at,) = np.nonzero(t == dwell)
        if not at.size:
            there = f"there are {t[0]} .. {t[-1]}" if t.size else "there is none yet"
            raise BadInput(f"dwell = {dwell}: {self._result.run} has no such dwell; {there}")
        return int(at[0])


def _new(axes: Axes | None) -> Axes:
    if axes is not None:
        return axes
    from matplotlib import pyplot as plt

    return plt.subplots(layout="constrained")[1]
