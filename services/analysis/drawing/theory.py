"""Figures of runs beside what theory says: detections against the law of the test, errors against their covariance."""

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from cogradar.services.analysis.drawing.looks import FAINT, INK, LINES, TARGETS, looks
from cogradar.services.analysis.results import Results
from cogradar.shared.scoring.errors import nees_band, wilson_interval
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.receiver import detection_probability, noncentrality, threshold
from cogradar.shared.world.disturbance import power_spectrum

Floats = NDArray[np.float64]

FEWEST = 20  # looks behind a mark
STEP_DB = 1.0
LAWS: tuple[Any, ...] = LINES[:3]  # a line for each law of the RCS
NEES = 4.0  # mean of an honest belief of four dimensions


def detection(results: Results) -> Figure:
    """Share of looks that were detections against the SNR at the test's output, zeta / 2, beside the closed form.

    The marks are over the looks within STEP_DB of all runs of a strategy, with Wilson's interval: the disturbance of a
    look is independent of all others. The curve holds for an echo from the centre of its cell.
    """
    radar, world = results.scenario.radar, results.scenario.simulated
    limit = threshold(radar.detector.p_fa)
    figure = Figure(figsize=(5.4, 3.6), layout="constrained")
    axes = figure.subplots()
    for strategy, look in looks(list(results.runs)).items():
        snr_db, detected = _tested(results, strategy)
        step = np.floor(snr_db / STEP_DB)
        for at in np.unique(step):
            mine = detected[step == at]
            if mine.size >= FEWEST:
                low, high = wilson_interval(int(mine.sum()), mine.size)
                middle = float(snr_db[step == at].mean())
                axes.plot([middle, middle], [low, high], color=look.colour, linewidth=1.0)
                axes.plot(middle, mine.mean(), "o", color=look.colour, markersize=3.5)
    curve = np.linspace(*axes.get_xlim(), 200)
    laws = sorted({target.rcs or world.rcs for target in world.targets})
    for law, line in zip(laws, LAWS, strict=False):
        p_d = detection_probability(2.0 * 10.0 ** (curve / 10.0), limit, law)
        axes.plot(curve, p_d, color=INK, linewidth=0.9, linestyle=line, zorder=1)
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlabel("SNR at the output of the test, dB")
    axes.set_ylabel("share detected, $P_D$")
    handles = [
        Line2D([], [], color=look.colour, marker="o", markersize=3.5, label=strategy)
        for strategy, look in looks(list(results.runs)).items()
    ]
    handles += [
        Line2D(
            [],
            [],
            color=INK,
            linewidth=0.9,
            linestyle=line,
            label=f"theory, {law} RCS",
        )
        for law, line in zip(laws, LAWS, strict=False)
    ]
    title = f"theory: an echo on the axis of its cell, noise known, $P_{{FA}}$ = {radar.detector.p_fa:g}"
    figure.legend(handles=handles, title=title, loc="outside upper center", ncols=3)
    return figure


def _tested(results: Results, strategy: str) -> tuple[Floats, Floats]:
    """SNR in dB and outcome, 0 or 1, of each look at the cell that held its target."""
    runs, array = results.runs[strategy], results.scenario.radar.array
    spectrum = power_spectrum(results.scenario.simulated.disturbance.model, bin_centres(array.n_bin))
    is_tested = (runs.signature_power > 0.0) & (runs.true_bin >= 0) & ~np.isnan(runs.detected)
    zeta = noncentrality(
        10.0 ** (runs.snr_db[is_tested] / 10.0), runs.signature_power[is_tested], spectrum[runs.true_bin[is_tested]]
    )
    return 10.0 * np.log10(0.5 * zeta), runs.detected[is_tested]


def consistency(results: Results) -> Figure:
    """NEES against time, the mean over runs, a panel a strategy, beside its 95 % band: of each target, or of all
    together if they are more than the colours.
    """
    drawn, n_target = looks(list(results.runs)), results.scenario.n_target
    are_apart = n_target <= len(TARGETS)
    figure = Figure(figsize=(7.2, 0.9 + 1.7 * len(drawn)), layout="constrained")
    panels = figure.subplots(len(drawn), 1, sharex=True, squeeze=False)[:, 0]
    lines = TARGETS[:n_target] if are_apart else TARGETS[:1]
    for axes, strategy in zip(panels, drawn, strict=True):
        nees = results.runs[strategy].nees  # (n, T, M)
        nees = nees if are_apart else np.moveaxis(nees, 2, 1).reshape(-1, results.dwells, 1)
        known = (~np.isnan(nees)).sum(axis=0)
        with np.errstate(invalid="ignore"):  # 0/0: no track
            means = np.nansum(nees, axis=0) / known
        n = np.where(known > 0, known, nees.shape[0]).min(axis=1)  # the widest band of the targets
        low, high = nees_band(n)
        axes.fill_between(results.t, low, high, color=FAINT, alpha=0.25, linewidth=0)
        axes.axhline(NEES, color=INK, linewidth=0.8)
        for m, look in enumerate(lines):
            axes.plot(results.t, means[:, m], color=look.colour, linestyle=look.line, linewidth=1.0)
        if np.nanmax(means, initial=NEES) > 4.0 * NEES:
            axes.set_yscale("log")
        axes.set_ylabel(f"NEES, {strategy}")
    panels[-1].set_xlabel("dwell $t$")
    panels[-1].set_xlim(0, results.dwells)
    handles: list[Artist] = [
        Line2D([], [], color=look.colour, linestyle=look.line, label=f"target {m + 1}" if are_apart else "all targets")
        for m, look in enumerate(lines)
    ]
    handles.append(Patch(color=FAINT, alpha=0.25, linewidth=0, label="95 % band of an honest belief"))
    figure.legend(handles=handles, loc="outside upper center", ncols=5)
    return figure
