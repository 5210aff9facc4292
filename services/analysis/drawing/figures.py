"""The figures of a store: the paper's three; power; GOSPA; the life of tracks; detections and errors beside theory."""

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from cogradar.services.analysis.drawing.gospa import gospa
from cogradar.services.analysis.drawing.life import life
from cogradar.services.analysis.drawing.looks import DOTTED, FAINT, FLOOR, INK, STYLE, Look, looks, target_looks
from cogradar.services.analysis.drawing.theory import consistency, detection
from cogradar.services.analysis.export.whole import made
from cogradar.services.analysis.results import Results, Snapshot, read_results, read_snapshots, running_mean
from cogradar.services.metrics.experiments import Experiment
from cogradar.services.metrics.recording import snapshots
from cogradar.services.metrics.store import Store
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.errors import bootstrap_interval, position_error, rmse, velocity_error, wilson_interval
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.waveform import beampattern

Floats = NDArray[np.float64]

WINDOW = 5  # dwells over which P_D is averaged
TRACKED = 1  # target 2, which the paper follows
N_TRACKED = 4  # runs of it
FLOOR_DB, TOP_DB = -30.0, 24.0  # of a beampattern
ACROSS = 4  # panels side by side, at most
MIN_WIDTH, LEGEND_WIDTH = 5.4, 2.5  # inches, of a figure and of an entry of its legend
HEADING = 70  # characters of a line
MARGIN_KM = 6.0  # around a true track
PANEL_ASPECT = 0.7  # height over width of its panel
FORMATS = ("png", "pdf")


def draw_all(
    store: Store, experiment: Experiment, folder: Path, notify: Callable[[str], None] = lambda _: None
) -> list[Path]:
    """Draw every figure of an experiment that the store has the data for, as PNG and PDF; returns the files."""
    results = read_results(store, experiment)
    seed, radiated = read_snapshots(store, results, snapshots(results.dwells))
    drawings: dict[str, Callable[[], Figure]] = {"accuracy": lambda: accuracy(results)}
    if radiated:
        drawings["beampatterns"] = lambda: beampatterns(results, radiated, seed)
    else:
        notify("no beampatterns: waveforms are kept by `cogradar campaign` and by `cogradar run --store`")
    drawings["tracks"] = lambda: tracks(results)
    if Strategy.POWER_AWARE in results.runs:
        drawings["power"] = lambda: power_shares(results)
    if results.scenario.radar.is_unknown and results.is_single:
        drawings["life"] = lambda: life(results)
    drawings["gospa"] = lambda: gospa(store, results)
    drawings["detection"] = lambda: detection(results)
    drawings["consistency"] = lambda: consistency(results)
    made(folder)
    files = []
    with mpl.rc_context(STYLE):
        for name, drawing in drawings.items():
            figure = drawing()
            if not experiment.alone:
                add_heading(figure, f"{experiment.label}: {experiment.title}")
            files += save(figure, folder / name)
    return files


def add_heading(figure: Figure, text: str) -> None:
    """Say above a figure's legend what it is of."""
    (legend,) = figure.legends
    lines = [*textwrap.wrap(text, HEADING), legend.get_title().get_text()]
    legend.set_title("\n".join(filter(None, lines)))


def save(figure: Figure, path: Path) -> list[Path]:
    """Save a figure as PNG and PDF, without date and version: the same store gives the same bytes."""
    files = [path.with_suffix(f".{suffix}") for suffix in FORMATS]
    for file in files:
        figure.savefig(file, metadata={"Software": None} if file.suffix == ".png" else {"CreationDate": None})
        figure.set_layout_engine("none")  # it costs as much as the drawing: the next format has the layout of this one
    return files


def accuracy(results: Results) -> Figure:
    """P_D, position and velocity error against time, three panels per target, at most four targets side by side.

    The paper's figure 1.
    """
    n_target, drawn = results.scenario.n_target, looks(list(results.runs))
    across = min(n_target, ACROSS)
    down = -(-n_target // across)
    width = max(MIN_WIDTH, 0.6 + 2.3 * across)
    figure = Figure(figsize=(width, 0.9 + 5.7 * down), layout="constrained")
    grid = figure.subplots(3 * down, across, sharex=True, sharey="row", squeeze=False)
    for m in range(down * across):
        column = grid[3 * (m // across) : 3 * (m // across) + 3, m % across]
        if m < n_target:
            _draw_accuracy(column, results, m, drawn)
        else:
            for axes in column:
                axes.set_axis_off()
    handles: list[Artist] = [
        Line2D([], [], color=drawn[s].colour, linestyle=drawn[s].line, label=f"{s} ({_counted(len(runs.seeds))})")
        for s, runs in results.runs.items()
    ]
    floor_label = "Cramér-Rao floor of the range, bearing given:\nno RMSE over many runs is less"
    if not results.is_single:
        handles.append(Patch(color=FAINT, alpha=0.3, linewidth=0, label="95 % interval over runs"))
    handles.append(Line2D([], [], color=FAINT, linewidth=0.8, linestyle=FLOOR, label=floor_label))
    figure.legend(handles=handles, loc="outside upper center", ncols=int(width // LEGEND_WIDTH))
    return figure


def _counted(runs: int) -> str:
    return "1 run" if runs == 1 else f"{runs} runs"


def _draw_accuracy(column: NDArray[Any], results: Results, m: int, drawn: dict[str, Look]) -> None:
    """The three panels of target m."""
    for strategy in reversed(results.runs):  # the first on top
        look, bound = drawn[strategy], results.floor(strategy, m)
        _draw_p_d(column[0], results, strategy, m, look)
        _draw_error(column[1], results, strategy, m, position_error, look)
        _draw_error(column[2], results, strategy, m, _velocity_error_m_s, look)
        for axes, floor in ((column[1], bound.position_km), (column[2], 1e3 * bound.velocity_km_s)):
            axes.plot(results.t, floor, color=look.colour, linewidth=0.8, linestyle=FLOOR)
    column[0].set_title(f"target {m + 1}")
    column[0].set_ylim(-0.03, 1.03)
    for axes in column[1:]:
        if np.isfinite(axes.dataLim.minposy):  # there is an error to draw
            axes.set_yscale("log")
    column[2].set_xlabel("dwell $t$")
    column[2].set_xlim(0, results.dwells)
    if m % ACROSS == 0:
        single = results.is_single
        column[0].set_ylabel(f"share detected in {WINDOW} dwells" if single else f"$P_D$, mean over {WINDOW} dwells")
        column[1].set_ylabel(f"position {'error' if single else 'RMSE'}, km")
        column[2].set_ylabel(f"velocity {'error' if single else 'RMSE'}, m/s")


def _draw_p_d(axes: Axes, results: Results, strategy: str, m: int, look: Look) -> None:
    """Share of runs in which target m was detected, over a running window.

    The band is Wilson's 95 % interval for as many trials as there are runs. The dwells of a window are not
    independent (a lost track misses them all), so more trials than that cannot be claimed.
    """
    detected = results.runs[strategy].detected[:, :, m]
    there = (~np.isnan(detected)).sum(axis=0)
    with np.errstate(invalid="ignore"):  # 0/0: no target
        p_d = running_mean(np.nansum(detected, axis=0) / there, WINDOW)
    n_run = detected.shape[0]
    _draw_line(axes, results.t, p_d, wilson_interval(p_d * n_run, np.full(p_d.shape, n_run)), n_run, look)


def _draw_error(
    axes: Axes, results: Results, strategy: str, m: int, error: Callable[[Floats, Floats], Floats], look: Look
) -> None:
    """Root mean squared error over the runs, with the bootstrap's 95 % interval."""
    runs = results.runs[strategy]
    errors = error(runs.estimate[:, :, m], runs.truth[:, :, m])
    rng = generator(0, Purpose.BOOTSTRAP, m, 0)
    _draw_line(axes, results.t, rmse(errors), bootstrap_interval(errors**2, rng, np.sqrt), len(errors), look)


def _velocity_error_m_s(estimates: Floats, truths: Floats) -> Floats:
    return 1e3 * velocity_error(estimates, truths)


def _draw_line(
    axes: Axes, t: NDArray[np.int64], middle: Floats, interval: tuple[Floats, Floats], n_run: int, look: Look
) -> None:
    if n_run > 1:
        axes.fill_between(t, *interval, color=look.colour, alpha=0.16, linewidth=0)
    # Broken lines above the solid one: where strategies agree, both are seen.
    axes.plot(t, middle, color=look.colour, linestyle=look.line, zorder=2.0 if look.line == "-" else 2.1)


def beampatterns(results: Results, radiated: list[Snapshot], seed: int) -> Figure:
    """Power a^T R a^* against angle at three dwells of one run per strategy; the paper's figure 2."""
    dwells = sorted({snapshot.t for snapshot in radiated})
    figure = Figure(figsize=(7.2, 0.5 + 1.75 * len(dwells)), layout="constrained")
    nus = np.linspace(-0.5, 0.5, 8001)
    angle, drawn = np.degrees(np.arcsin(2.0 * nus)), looks(list(results.runs))
    columns = figure.subplots(len(dwells), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, t in zip(columns, dwells, strict=True):
        shown = [snapshot for snapshot in radiated if snapshot.t == t]
        for snapshot in reversed(shown):
            power = beampattern(snapshot.waveform.isotropic, snapshot.waveform.factor.astype(np.complex128), nus)
            look = drawn[snapshot.strategy]
            level = 10.0 * np.log10(np.maximum(power, 1e-12))
            axes.plot(angle, level, color=look.colour, linestyle=look.line, linewidth=1.0)
        _mark_targets(axes, shown[0], results.scenario.radar.array.n_bin)
        axes.set_ylim(FLOOR_DB, TOP_DB)
        axes.set_ylabel("$a^T R a^*$, dB")
        axes.text(0.008, 0.94, f"$t$ = {t}", transform=axes.transAxes, va="top", weight="bold")
    columns[-1].set_xlabel("angle from boresight, degrees")
    columns[-1].set_xlim(-90, 90)
    columns[-1].set_xticks(np.arange(-90, 91, 30))
    handles = [Line2D([], [], color=look.colour, linestyle=look.line, label=s) for s, look in drawn.items()]
    handles.append(Line2D([], [], color=FAINT, linewidth=0.8, label=f"true bin and SNR of a target, seed {seed}"))
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 4))
    return figure


def _mark_targets(axes: Axes, snapshot: Snapshot, n_bin: int) -> None:
    angles = np.degrees(np.arcsin(2.0 * bin_centres(n_bin)[snapshot.true_bin]))
    for m, (angle, snr_db) in enumerate(zip(angles, snapshot.snr_db, strict=True)):
        if snapshot.true_bin[m] < 0:
            continue
        axes.axvline(angle, color=FAINT, linewidth=0.8, zorder=0)
        inwards = "right" if angle > 60 else "left"
        gap = -1.0 if inwards == "right" else 1.0
        # Of many targets the SNR has no room.
        label = f"{m + 1}: ${snr_db:.1f}$ dB" if len(angles) <= ACROSS else f"{m + 1}"
        axes.text(angle + gap, TOP_DB - 1.5, label, ha=inwards, va="top", color=INK, size=7.5)


def tracks(results: Results) -> Figure:
    """Truth and estimate: of target 2 in four runs, the paper's figure 3; of a single run, of all its targets."""
    strategy, runs = next(iter(results.runs.items()))
    look, n_target = looks(list(results.runs))[strategy], results.scenario.n_target
    if len(runs.seeds) == 1:
        shown = [(0, m) for m in range(n_target)]
        across = next(n for n in range(1, ACROSS + 1) if n == ACROSS or n * n >= n_target)
    else:
        shown = [(i, min(TRACKED, n_target - 1)) for i in range(min(N_TRACKED, len(runs.seeds)))]
        across = 2
    down = -(-len(shown) // across)
    figure = Figure(figsize=(3.6 * max(across, 2), 0.8 + 2.4 * down), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False).ravel()
    for axes in grid[len(shown) :]:
        axes.set_axis_off()
    for axes, (i, m) in zip(grid, shown, strict=False):
        _draw_track(axes, runs.truth[i, :, m], runs.estimate[i, :, m], look, snapshots(results.dwells))
        name = f"target {m + 1}" if len(runs.seeds) == 1 else f"seed {runs.seeds[i]}"
        axes.set_title(name if runs.detected[i, -1, m] != 0.0 else f"{name}, not detected at the end")
    figure.supxlabel("$x$ (boresight), km", size=8.5)
    figure.supylabel("$y$, km", size=8.5)
    whose = "targets" if len(runs.seeds) == 1 else f"target {shown[0][1] + 1}"
    handles = [
        Line2D([], [], color=INK, linewidth=2.4, marker="o", markersize=4, label=f"{whose}, true"),
        Line2D([], [], color=look.colour, linewidth=1.1, marker="s", mfc="white", markersize=4, label="estimate"),
    ]
    of_one = f", seed {runs.seeds[0]}" if len(runs.seeds) == 1 else ""
    title = f"{strategy}{of_one}; circles and squares at the same dwells"
    figure.legend(handles=handles, title=title, loc="outside upper center", ncols=2)
    return figure


def _draw_track(axes: Axes, truth: Floats, estimate: Floats, look: Look, marked: tuple[int, ...]) -> None:
    """One track in the plane, cut off where the estimate is far from anywhere the target has been."""
    axes.plot(truth[:, 0], truth[:, 2], color=INK, linewidth=2.4)
    axes.plot(estimate[:, 0], estimate[:, 2], color=look.colour, linewidth=1.1)
    there = np.flatnonzero(~np.isnan(truth[:, 0]))
    if not there.size:
        return
    at = np.intersect1d(np.array(marked) - 1, there)
    axes.plot(truth[at, 0], truth[at, 2], "o", color=INK, markersize=4)
    axes.plot(estimate[at, 0], estimate[at, 2], "s", mfc="white", mec=look.colour, markersize=4)
    for i, x, y in zip(at, truth[at, 0], truth[at, 2], strict=True):
        axes.annotate(f"$t$ = {i + 1}", (x, y), xytext=(-5, 5), textcoords="offset points", ha="right", size=7.5)
    # Both axes to one scale, around where the target was.
    low, high = np.nanmin(truth[:, [0, 2]], axis=0), np.nanmax(truth[:, [0, 2]], axis=0)
    width = max(high[0] - low[0], (high[1] - low[1]) / PANEL_ASPECT) + 2.0 * MARGIN_KM
    half = 0.5 * width * np.array([1.0, PANEL_ASPECT])
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_box_aspect(PANEL_ASPECT)


def power_shares(results: Results) -> Figure:
    """Share of the power on each target against time, power-aware, beside what the true ranges would ask for."""
    runs, power = results.runs[Strategy.POWER_AWARE], results.scenario.radar.array.power
    share = runs.share / power
    fourth = np.hypot(runs.truth[..., 0], runs.truth[..., 2]) ** 4
    of_all = np.maximum(np.nansum(fourth, axis=-1, keepdims=True), 1e-9)
    ideal = np.where(np.isnan(fourth), 0.0, fourth / of_all).mean(axis=0)
    n_target = share.shape[-1]
    figure = Figure(figsize=(7.2, 3.4 + 0.2 * (n_target // 5)), layout="constrained")
    axes = figure.subplots()
    for m, look in enumerate(target_looks(n_target)):
        if share.shape[0] > 1:
            low, high = np.quantile(share[..., m], [0.1, 0.9], axis=0)
            axes.fill_between(results.t, low, high, color=look.colour, alpha=0.16, linewidth=0)
        axes.plot(
            results.t, share[..., m].mean(axis=0), color=look.colour, linestyle=look.line, label=f"target {m + 1}"
        )
        axes.plot(results.t, ideal[:, m], color=INK, linewidth=0.8, linestyle=DOTTED)
    axes.axhline(1.0 / n_target, color=FAINT, linewidth=0.8, label="uniform")
    axes.plot([], [], color=INK, linewidth=0.8, linestyle=DOTTED, label="$R^4/\\Sigma R^4$ of the true ranges")
    axes.set_xlim(0, results.dwells)
    axes.set_ylim(0, 1)
    axes.set_xlabel("dwell $t$")
    axes.set_ylabel(f"share of the power{': mean, 10-90 % of runs' if share.shape[0] > 1 else ''}")
    figure.legend(loc="outside upper center", ncols=min(n_target + 2, 5))
    return figure
