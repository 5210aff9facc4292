"""Figures from a store of small runs: the right numbers are drawn, and files are written. Looks are for eyes."""

import json
import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import fields, replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from typer.testing import CliRunner

from cogradar.services.analysis.drawing import figures, theory
from cogradar.services.analysis.drawing.gospa import gospa
from cogradar.services.analysis.drawing.life import life
from cogradar.services.analysis.drawing.looks import FAINT, INK, LOOKS, STYLE, TARGETS, target_looks
from cogradar.services.analysis.results import Results, StrategyRuns, read_results, read_snapshots, running_mean
from cogradar.services.cli import app as cli
from cogradar.services.metrics.client import open_store
from cogradar.services.metrics.experiments import Experiment, experiments
from cogradar.services.metrics.recording import snapshots, take
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.errors import nees_band
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.receiver import detection_probability, threshold
from cogradar.shared.world.disturbance import power_spectrum

DWELLS = 8
SEEDS = (3, 4)
WITHOUT_WAVEFORMS = {"accuracy", "tracks", "power", "gospa", "detection", "consistency"}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "runs.db"
    store = Store(Journal(str(path)))
    for seed in SEEDS:
        for strategy in Strategy:
            in_process.play(RunStart.of(load("smoke"), strategy, seed, DWELLS), store=store)
    store.close()
    return path


@pytest.fixture
def store(file: Path) -> Iterator[Store]:
    with closing(open_store(str(file))) as opened:
        yield opened


@pytest.fixture
def results(store: Store) -> Results:
    return read_results(store, _experiment(store))


def _experiment(store: Store) -> Experiment:
    (one,) = experiments(store, Selection(run="all"))
    return one


def texts(figure: Figure) -> list[str]:
    axes = [text for axes in figure.axes for text in (axes.xaxis.label, axes.yaxis.label, axes.title, *axes.texts)]
    return [text.get_text() for text in [*axes, *(t for legend in figure.legends for t in legend.get_texts())]]


def test_gospa_and_its_parts_are_root_mean_squares_over_runs(store: Store, results: Results) -> None:
    figure = gospa(store, results)
    runs = [run["run"] for run in _experiment(store).of(Strategy.UNIFORM)]
    of_runs = [[row for row in store.read("SELECT * FROM picture ORDER BY t") if row["run"] == run] for run in runs]
    missed = np.array([[row["missed_km2"] for row in rows] for rows in of_runs])
    every = np.array([[row["missed_km2"] + row["false_km2"] + row["localisation_km2"] for row in r] for r in of_runs])
    for axes, squares in ((figure.axes[0], every), (figure.axes[2], missed)):
        line = axes.lines[1]
        assert np.asarray(line.get_xdata()).tolist() == list(range(1, DWELLS + 1))
        assert np.asarray(line.get_ydata()) == pytest.approx(np.sqrt(squares.mean(axis=0)))
    assert {"GOSPA, km", "false, km", "uniform (2)"} <= set(texts(figure))


def test_results_are_the_rows_of_the_store(store: Store, results: Results) -> None:
    assert list(results.runs) == [Strategy.POWER_AWARE, Strategy.UNIFORM, Strategy.ORTHOGONAL]
    for strategy, runs in results.runs.items():
        assert runs.seeds == SEEDS
        assert runs.truth.shape == (2, DWELLS, 2, 4)
        (row,) = store.read(
            "SELECT * FROM score JOIN run USING (run) WHERE strategy = ? AND seed = 4 AND t = 6 AND target = 2",
            [strategy],
        )
        at = (1, 5, 1)
        assert runs.detected[at] == bool(row["detected"])
        assert (runs.true_bin[at], runs.snr_db[at], runs.share[at]) == (row["true_bin"], row["snr_db"], row["share"])
        assert runs.truth[at].tolist() == [row["x"], row["vx"], row["y"], row["vy"]]
        assert runs.estimate[at].tolist() == [row["x_hat"], row["vx_hat"], row["y_hat"], row["vy_hat"]]


def test_snapshots_are_the_waveforms_of_their_dwells(store: Store, results: Results) -> None:
    seed, radiated = read_snapshots(store, results, snapshots(DWELLS))
    assert seed == SEEDS[0]
    assert [(s.strategy, s.t) for s in radiated] == [(s, t) for s in results.runs for t in snapshots(DWELLS)]
    for snapshot in radiated:
        rows = store.read(
            "SELECT bin, share, true_bin, snr_db FROM score JOIN run USING (run)"
            " WHERE strategy = ? AND seed = ? AND t = ? ORDER BY track",
            [snapshot.strategy, seed, snapshot.t],
        )
        assert snapshot.waveform.beams[:, 0].tolist() == [row["bin"] for row in rows]
        assert snapshot.waveform.shares[:, 0].tolist() == [row["share"] for row in rows]
        assert sorted(snapshot.true_bin.tolist()) == sorted(row["true_bin"] for row in rows)
        assert sorted(snapshot.snr_db.tolist()) == sorted(row["snr_db"] for row in rows)


def test_bound_follows_the_power(results: Results) -> None:
    # Uniform: half of the power on 16 antennas' beam, 8 times what the orthogonal waveform sends there.
    bound = {strategy: results.bound(strategy, 0, velocity_sigma=0.2).position_km for strategy in results.runs}
    assert np.all(bound[Strategy.UNIFORM] < bound[Strategy.ORTHOGONAL])
    assert bound[Strategy.UNIFORM].shape == (DWELLS,)


def test_floor_begins_where_the_prior_no_longer_matters(results: Results) -> None:
    # A range known to sigma at every dwell gives a velocity after 8 dwells to sigma sqrt(12/8^3): here far from it.
    assert np.all(np.isnan(results.floor(Strategy.ORTHOGONAL, 0).velocity_km_s))
    # With echoes 40 dB stronger, ranges a hundred times as sure: from the first dwell.
    strong = {strategy: replace(runs, snr_db=runs.snr_db + 40.0) for strategy, runs in results.runs.items()}
    floor = replace(results, runs=strong).floor(Strategy.UNIFORM, 0)
    assert np.all(np.isfinite([floor.position_km, floor.velocity_km_s]))


def test_accuracy_draws_the_shares_and_errors(results: Results) -> None:
    figure = figures.accuracy(results)
    assert len(figure.axes) == 3 * 2
    runs = results.runs[Strategy.UNIFORM]
    colour = LOOKS[Strategy.UNIFORM].colour
    p_d, position, velocity = (
        next(line for line in figure.axes[i].lines if line.get_color() == colour) for i in (1, 3, 5)
    )  # of target 2
    assert p_d.get_ydata() == pytest.approx(running_mean(runs.detected[:, :, 1].mean(axis=0), figures.WINDOW))
    error = runs.estimate[:, :, 1] - runs.truth[:, :, 1]
    assert position.get_ydata() == pytest.approx(np.sqrt((error[..., 0] ** 2 + error[..., 2] ** 2).mean(axis=0)))
    in_km_s = np.sqrt((error[..., 1] ** 2 + error[..., 3] ** 2).mean(axis=0))
    assert velocity.get_ydata() == pytest.approx(1000.0 * in_km_s)
    said = texts(figure)
    assert {"position RMSE, km", "velocity RMSE, m/s"} <= set(said)
    assert any("5 dwells" in text for text in said)
    assert any("floor" in text and "no RMSE over many runs is less" in text for text in said)
    assert "uniform (2 runs)" in said


def test_beampatterns_mark_the_true_bins(store: Store, results: Results) -> None:
    seed, radiated = read_snapshots(store, results, snapshots(DWELLS))
    figure = figures.beampatterns(results, radiated, seed)
    first = radiated[0]
    said = texts(figure)
    for m, snr_db in enumerate(first.snr_db):
        assert f"{m + 1}: ${snr_db:.1f}$ dB" in said
    # The orthogonal waveform sends the total power, 1, in all directions: 0 dB.
    colour = LOOKS[Strategy.ORTHOGONAL].colour
    flat = next(line for line in figure.axes[0].lines if line.get_color() == colour)
    assert np.asarray(flat.get_ydata()) == pytest.approx(0.0, abs=1e-9)


def test_tracks_show_as_many_runs_as_there_are(results: Results) -> None:
    figure = figures.tracks(results)
    assert [axes.get_title() for axes in figure.axes if axes.axison] == ["seed 3", "seed 4"]
    truth = figure.axes[0].lines[0]
    assert truth.get_xdata() == pytest.approx(results.runs[Strategy.POWER_AWARE].truth[0, :, 1, 0])


def test_detections_are_counted_where_the_law_of_the_test_says(results: Results) -> None:
    """Each mark is of the looks of a decibel; the curve is the closed form."""
    axes = theory.detection(_often(results, 0.75)).axes[0]
    marks = [line for line in axes.lines if line.get_marker() == "o"]
    assert marks
    for mark in marks:
        assert np.asarray(mark.get_ydata()) == pytest.approx(0.75, abs=0.03)
        assert np.asarray(mark.get_xdata()) == pytest.approx(15.0)
    (curve,) = (line for line in axes.lines if line.get_color() == INK)
    zeta = 2.0 * 10.0 ** (np.asarray(curve.get_xdata()) / 10.0)
    expected = detection_probability(zeta, threshold(results.scenario.radar.detector.p_fa))
    assert np.asarray(curve.get_ydata()) == pytest.approx(expected)


def _often(results: Results, share: float) -> Results:
    """The same with looks of 15 dB at the output, of which such a share are detections."""
    array, middle = results.scenario.radar.array, results.scenario.radar.array.n_bin // 2
    spectrum = power_spectrum(results.scenario.simulated.disturbance.model, bin_centres(array.n_bin))[middle]

    def looked(runs: StrategyRuns) -> StrategyRuns:
        shape, n = runs.detected.shape, runs.detected.size
        detected = (np.arange(n) < share * n).astype(np.float64)
        power = np.full(shape, 10.0**1.5 * float(spectrum))
        return replace(
            runs,
            detected=detected.reshape(shape),
            snr_db=np.zeros(shape),
            signature_power=power,
            true_bin=np.full(shape, middle),
        )

    return replace(results, runs={strategy: looked(runs) for strategy, runs in results.runs.items()})


def test_errors_are_within_the_band_of_an_honest_belief(results: Results) -> None:
    """Of chi-square values with four degrees of freedom, 95 % of the means are between the ends of the band."""
    rng = np.random.default_rng(1)

    def honest(runs: StrategyRuns) -> StrategyRuns:
        return replace(runs, nees=rng.chisquare(4.0, runs.nees.shape))

    drawn = theory.consistency(replace(results, runs={s: honest(runs) for s, runs in results.runs.items()}))
    for axes in drawn.axes:
        (band,) = axes.collections
        path = np.asarray(band.get_paths()[0].vertices)
        low, high = path[:, 1].min(), path[:, 1].max()
        means = np.concatenate([np.asarray(line.get_ydata()) for line in axes.lines[1:]])
        assert (low, high) == pytest.approx(tuple(map(float, nees_band(len(SEEDS)))))
        assert ((means >= low) & (means <= high)).mean() > 0.8
        assert means.size == DWELLS * results.scenario.n_target


def test_the_life_of_tracks_has_a_gap_where_none_follows(results: Results) -> None:
    """Target 2 comes later; target 1 loses its track and gets another one."""
    (strategy, runs), *_ = results.runs.items()
    nan = float("nan")
    there = np.array([[1] * 8, [0, 0, 1, 1, 1, 1, 1, 1]]).T
    track = np.array([[nan, 1, 1, 1, nan, nan, 3, 3], [nan] * 3 + [2] * 5]).T
    flown = replace(runs, true_bin=np.where(there, 3, -1)[None], visible=there.astype(float)[None], track=track[None])
    axes = life(replace(results, runs={strategy: flown})).axes[0]
    drawn = [
        (to_hex(np.asarray(line.get_colors())[0]), [[*segment[:, 0], segment[0, 1]] for segment in line.get_segments()])
        for line in axes.collections
        if isinstance(line, LineCollection)
    ]
    followed = [(colour.upper(), spans) for colour, spans in drawn if colour != to_hex(FAINT)]
    first, second = TARGETS[0].colour, TARGETS[1].colour
    assert followed == [(first, [[1.5, 4.5, 0.0]]), (second, [[6.5, 8.5, 0.0]]), (first, [[3.5, 8.5, 1.0]])]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["1", "2"]


def test_power_shares_add_up(results: Results) -> None:
    figure = figures.power_shares(results)
    means = [
        np.asarray(line.get_ydata()) for line in figure.axes[0].lines if str(line.get_label()).startswith("target")
    ]
    assert np.sum(means, axis=0) == pytest.approx(1.0)


@pytest.mark.parametrize("window", [1, 2, 5, 30])
def test_running_mean_is_over_what_there_is(window: int) -> None:
    values = np.random.default_rng(0).random(12)
    before, after = window // 2, (window - 1) // 2
    expected = [values[max(i - before, 0) : i + after + 1].mean() for i in range(12)]
    assert running_mean(values, window) == pytest.approx(expected)


@pytest.mark.nightly
def test_command_writes_the_same_files_twice(file: Path, tmp_path: Path) -> None:
    for folder in ("one", "two"):
        done = CliRunner().invoke(cli.app, ["figures", str(file), "--out", str(tmp_path / folder)])
        assert done.exit_code == 0, done.output
    names = {f"{n}.{s}" for n in (*WITHOUT_WAVEFORMS, "beampatterns") for s in ("png", "pdf")}
    assert {path.name for path in (tmp_path / "one").iterdir()} == names
    for name in names:
        data = (tmp_path / "one" / name).read_bytes()
        assert data.startswith(b"\x89PNG" if name.endswith("png") else b"%PDF")
        assert (tmp_path / "two" / name).read_bytes() == data


@pytest.mark.nightly
def test_experiments_have_a_folder_each_and_can_be_chosen(file: Path, tmp_path: Path) -> None:
    mixed = Path(shutil.copy(file, tmp_path / "mixed.db"))
    store = Store(Journal(str(mixed)))
    in_process.play(RunStart.of(load("smoke"), Strategy.UNIFORM, 1, 3), store=store)
    store.close()
    done = CliRunner().invoke(cli.app, ["figures", str(mixed), "--out", str(tmp_path / "all")])
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == ["smoke-3", f"smoke-{DWELLS}"]
    chosen = CliRunner().invoke(cli.app, ["figures", str(mixed), "--seed", "1", "--out", str(tmp_path / "one")])
    assert chosen.exit_code == 0, chosen.output
    assert {path.stem for path in (tmp_path / "one").iterdir()} == {*WITHOUT_WAVEFORMS, "beampatterns"} - {"power"}
    for command in ("figures", "report"):
        for wrong, words in ((["--seed", "77"], "seed = 77"), (["--run", "nobody"], "run = nobody")):
            refused = CliRunner().invoke(cli.app, [command, str(mixed), *wrong])
            assert (refused.exit_code, refused.stdout) == (2, "")
            assert f"{mixed}: no complete run with truth in this store, of {words}" in refused.stderr
    reported = CliRunner().invoke(cli.app, ["report", str(mixed), "--json"])
    assert [one["dwells"] for one in json.loads(reported.stdout)] == [DWELLS, 3]


def test_unusable_stores_are_bad_input(tmp_path: Path) -> None:
    empty = tmp_path / "empty.db"
    Journal(str(empty)).close()
    for store in (empty, tmp_path / "nowhere.db"):
        done = CliRunner().invoke(cli.app, ["figures", str(store), "--out", str(tmp_path)])
        assert done.exit_code == 2
        assert store.name in done.output


def test_a_single_run_shows_all_its_targets(store: Store) -> None:
    (run, *_) = store.read("SELECT run, seed FROM run WHERE strategy = 'uniform'")
    (one,) = experiments(store, Selection(run=run["run"]))
    results = read_results(store, one)
    figure = figures.tracks(results)
    shown = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_title().partition(",")[0] for axes in shown] == ["target 1", "target 2"]
    for m, axes in enumerate(shown):
        assert axes.lines[0].get_xdata() == pytest.approx(results.runs["uniform"].truth[0, :, m, 0])


def test_what_is_drawn_of_a_single_run_is_called_its_own(results: Results) -> None:
    single = replace(results, runs={s: _first(runs) for s, runs in results.runs.items()})
    for of, words, bands in ((single, "position error, km", 0), (results, "position RMSE, km", len(Strategy))):
        drawn = figures.accuracy(of)
        assert words in texts(drawn)
        assert any("interval" in text for text in texts(drawn)) == bool(bands)
        assert {len(axes.collections) for axes in drawn.axes} == {bands}


def test_a_figure_says_which_variant_it_is_of(results: Results, store: Store) -> None:
    seed, radiated = read_snapshots(store, results, snapshots(DWELLS))
    for drawn in (
        figures.accuracy(results),
        figures.beampatterns(results, radiated, seed),
        figures.tracks(results),
        figures.power_shares(results),
    ):
        figures.add_heading(drawn, "smoke-1: radar.array.n_tx = 8")
        assert drawn.legends[0].get_title().get_text().splitlines()[0] == "smoke-1: radar.array.n_tx = 8"


def _many(results: Results, n_target: int) -> Results:
    """The same runs with so many targets, and one strategy of which nothing is known here."""
    at = np.arange(n_target) % 2
    radar = results.scenario.radar.model_copy(update={"tracks": n_target})
    world = results.scenario.simulated
    world = world.model_copy(update={"targets": [world.targets[m] for m in at]})
    scenario = results.scenario.model_copy(update={"radar": radar, "world": world})
    kept = ("names", "seeds", "acquisition_scans")
    runs = {
        strategy: replace(
            runs, **{f.name: getattr(runs, f.name)[:, :, at] for f in fields(StrategyRuns) if f.name not in kept}
        )
        for strategy, runs in results.runs.items()
    }
    return replace(results, scenario=scenario, runs=runs | {"proportional": runs[Strategy.UNIFORM]})


@pytest.mark.parametrize("n_target", [1, 12])
def test_nothing_is_cropped_and_no_look_is_used_twice(n_target: int, results: Results, store: Store) -> None:
    many = _many(results, n_target)
    seed, radiated = read_snapshots(store, results, snapshots(DWELLS))
    at = np.arange(n_target) % 2
    radiated = [replace(s, true_bin=s.true_bin[at], snr_db=s.snr_db[at]) for s in radiated]
    radiated += [replace(s, strategy="proportional") for s in radiated if s.strategy == Strategy.UNIFORM]
    single = replace(many, runs={s: _first(runs) for s, runs in many.runs.items()})
    with mpl.rc_context(STYLE):
        drawn = {
            "accuracy": figures.accuracy(many),
            "beampatterns": figures.beampatterns(many, radiated, seed),
            "tracks": figures.tracks(many),
            "tracks of one run": figures.tracks(single),
            "power": figures.power_shares(many),
            "detection": theory.detection(many),
            "consistency": theory.consistency(many),
        }
        for name, figure in drawn.items():
            FigureCanvasAgg(figure).draw()
            for part in [*figure.legends, *(axes.title for axes in figure.axes if axes.axison)]:
                box = part.get_window_extent()
                assert 0.0 <= box.x0 <= box.x1 <= figure.bbox.width, (name, part)
                assert 0.0 <= box.y0 <= box.y1 <= figure.bbox.height, (name, part)
    assert "proportional (2 runs)" in texts(drawn["accuracy"])
    assert sum(axes.axison for axes in drawn["tracks of one run"].axes) == n_target
    for name in ("accuracy", "power"):
        (legend,) = drawn[name].legends
        lines = [line for line in legend.get_lines() if line.get_color() not in {FAINT, INK}]
        colours = [line.get_color() for line in lines]
        assert len(set(colours)) == len(colours) == (n_target if name == "power" else len(many.runs))
    assert len({look.colour for look in target_looks(30)}) == 30


def _first(runs: StrategyRuns) -> StrategyRuns:
    return replace(runs, **{f.name: getattr(runs, f.name)[:1] for f in fields(StrategyRuns)})


def test_without_waveforms_the_rest_is_drawn(store: Store, tmp_path: Path) -> None:
    bare, said = in_memory(), list[str]()
    for place, row in enumerate(store.read("SELECT run FROM run")):
        recording = take(store, row["run"])
        assert recording is not None
        bare.journal.add_recording(replace(recording, messages=[]), place)
    files = figures.draw_all(bare, _experiment(bare), tmp_path / "out", said.append)
    assert {path.stem for path in files} == WITHOUT_WAVEFORMS
    assert "campaign" in said[0]
