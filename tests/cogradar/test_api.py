"""The public face as a user has it: a scenario is loaded, played and looked at; a store and a service are asked."""

import json
import pydoc
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cogradar
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart

COGRADAR = [sys.executable, "-m", "cogradar"]
DWELLS, TARGETS = 30, 2


@pytest.fixture(scope="module")
def result() -> cogradar.Result:
    return cogradar.run(cogradar.load("smoke"), strategy="uniform", seed=3, dwells=DWELLS)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A store with the same run, and one of another strategy."""
    path = str(tmp_path_factory.mktemp("store") / "runs.db")
    store = Store(Journal(path))
    for strategy in (cogradar.Strategy.UNIFORM, cogradar.Strategy.POWER_AWARE):
        in_process.play(RunStart.of(cogradar.load("smoke"), strategy, 3, DWELLS), store=store)
    store.close()
    return path


def test_arrays_have_the_shapes_and_kinds_that_are_documented(result: cogradar.Result) -> None:
    arrays = [result.true_states, result.estimates, result.detected, result.true_bins, result.bins, result.shares]
    found = [(array.shape, array.dtype.name) for array in [*arrays, result.snr_db]]
    states, flat = (DWELLS, TARGETS, 4), (DWELLS, TARGETS)
    kinds = ["float64", "float64", "bool", "int64", "int64", "float64", "float64"]
    assert found == list(zip([states, states, *5 * [flat]], kinds, strict=True))


def test_truth_moves_as_the_scenario_says_and_estimates_are_near(result: cogradar.Result) -> None:
    starts = np.array([target.state for target in result.scenario.simulated.targets])
    moved = result.true_states[0] - starts
    assert np.abs(moved[:, [0, 2]] - starts[:, [1, 3]]).max() < 0.1  # one dwell of one second
    assert np.median(np.hypot(*(result.estimates - result.true_states)[..., [0, 2]].T)) < 5.0  # km
    assert np.allclose(result.shares, 1.0 / TARGETS)  # uniform
    on_target = result.bins == result.true_bins
    assert not result.detected[~on_target].any() or on_target.mean() > 0.5


def test_numbers_are_those_of_the_command_line(result: cogradar.Result) -> None:
    command = [*COGRADAR, "run", "smoke", "--in-process", "--strategy", "uniform", "--seed", "3", "--json"]
    done = subprocess.run([*command, "--dwells", str(DWELLS)], capture_output=True, text=True, check=True)
    printed: dict[str, Any] = json.loads(done.stdout)
    assert (result.digest, result.acquisition_scans) == (printed["digest"], printed["acquisition_scans"])
    for key in ("p_d", "position_rmse_km", "velocity_rmse_km_s"):
        assert getattr(result, key) == pytest.approx([row[key] for row in printed["targets"]], rel=1e-12)
    low_high = [[row["p_d_low"], row["p_d_high"]] for row in printed["targets"]]
    assert result.p_d_interval == pytest.approx(np.array(low_high), rel=1e-12)


def test_several_planners_change_nothing_and_progress_is_reported() -> None:
    told: list[tuple[int, int]] = []
    one = cogradar.run("smoke", dwells=DWELLS)
    three = cogradar.run("smoke", dwells=DWELLS, planners=3, progress=lambda done, of: told.append((done, of)))
    assert three.digest == one.digest
    assert told == sorted(told)
    assert all(of == DWELLS for _, of in told)


def test_without_truth_there_is_nothing_to_compare_with(file: str) -> None:
    recorded = cogradar.open(file)
    name = recorded.result().run
    store = in_memory()
    start = RunStart.of(cogradar.load("smoke").model_copy(update={"world": None}), cogradar.Strategy.UNIFORM, 3, DWELLS)
    in_process.play(start, store=store, front_end=f"recorded:{file}#{name}")
    blind = cogradar.Runs(partial(answer, store)).result()
    assert not blind.has_truth
    assert np.array_equal(blind.estimates.shape, (DWELLS, TARGETS, 4))
    for unknown in ("true_states", "true_bins", "snr_db", "p_d", "p_d_interval", "position_rmse_km"):
        with pytest.raises(cogradar.BadInput, match=f"{start.run}: there is no truth"):
            getattr(blind, unknown)
    store.close()
    recorded.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"seed": -1}, "seed = -1: must be an integer >= 0"),
        ({"dwells": 0}, "dwells = 0: must be an integer >= 1"),
        ({"strategy": "best"}, "strategy = 'best': must be one of orthogonal, uniform, power-aware"),
        ({"planners": 0}, "planners = 0"),
        ({"seed": "a"}, "seed = 'a': must be a whole number"),
        ({"seed": 1.5}, "seed = 1.5: must be a whole number"),
        ({"planners": "a"}, "planners = 'a': must be a whole number"),
        ({"dwells": "a"}, "dwells = 'a': must be a whole number"),
        ({"scenario": 7}, "7: no such scenario"),
        ({"scenario": "nowhere"}, "nowhere: no such scenario"),
    ],
)
def test_what_makes_no_sense_is_bad_input(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(cogradar.CogradarError) as caught:
        cogradar.run(**{"scenario": "smoke"} | arguments)
    assert isinstance(caught.value, cogradar.BadInput)
    assert words in str(caught.value)


def test_a_scenario_is_loaded_from_a_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(Path("deploy/scenarios/smoke.toml").read_text().replace('name = "smoke"', 'name = "mine"'))
    assert cogradar.load(path).name == "mine"


def test_a_store_is_asked_in_python(file: str, result: cogradar.Result) -> None:
    with cogradar.open(file) as opened:
        assert [row["strategy"] for row in opened.runs()] == ["uniform", "power-aware"]
        (name,) = (row["run"] for row in opened.runs(strategy="uniform"))
        (row,) = opened.p_d(run=name, target=2)
        assert row["p_d"] == pytest.approx(result.p_d[1])
        assert [row["strategy"] for row in opened.p_d(target=2)] == ["power-aware"]  # of the newest
        tracks = opened.tracks(run=name, target=1, dwells=(2, 4))
        assert [row["t"] for row in tracks] == [2, 3, 4]
        assert [row["x_hat"] for row in tracks] == result.estimates[1:4, 0, 0].tolist()
        (picture,) = opened.picture(run=name)
        assert picture["gospa_km"] == pytest.approx(np.sqrt(np.mean(result.picture.gospa_km**2)))
        assert len(opened.rmse(run="all")) == len(opened.summary(run="all")) == 2 * TARGETS
        with pytest.raises(cogradar.BadInput, match="no such run"):
            opened.p_d(run="nobody")
        with pytest.raises(cogradar.BadInput, match=r"nowhere\.db"):
            cogradar.open("nowhere.db")


def test_dwells_are_given_as_a_pair_or_as_on_the_command_line(file: str) -> None:
    with cogradar.open(file) as opened:
        assert opened.tracks(dwells="2:4") == opened.tracks(dwells=(2, 4))
        assert opened.p_d(dwells="29:")[0]["n"] == 2
        for dwells, words in (
            ((1, 2, 3), r"dwells = \(1, 2, 3\): must be"),
            (5, "dwells = 5: must"),
            ("a", "dwells = 'a'"),
        ):
            with pytest.raises(cogradar.BadInput, match=words):
                opened.p_d(dwells=dwells)  # type: ignore[arg-type] # what somebody may type


def test_what_is_shown_of_runs_says_whose_they_are_and_what_to_ask(file: str) -> None:
    with cogradar.open(file) as opened:
        assert repr(opened).startswith(f"<Runs of {file}: ask .runs(), .result(), ")
    assert repr(cogradar.connect("tcp/a:1")).startswith("<Runs of tcp/a:1: ")


def test_help_begins_with_the_main_calls_and_is_short_enough_to_read() -> None:
    text = pydoc.plain(pydoc.render_doc(cogradar))
    calls = [text.index(f"cogradar.{name}(") for name in ("run", "open", "connect", "load")]
    assert max(calls) < text.index("CLASSES")
    assert max(map(len, text.partition("CLASSES")[0].splitlines())) <= 120
    assert "pydantic" not in text
    assert len(text.splitlines()) < 500


def test_nobody_to_ask_is_said() -> None:
    with pytest.raises(cogradar.NoMetrics, match="no metrics service"):
        cogradar.connect("tcp/127.0.0.1:1").runs()


@pytest.mark.parametrize("endpoint", ["foo", "tcp/foo", "tcp/127.0.0.1:99999", ""])
def test_what_can_be_no_endpoint_is_refused_at_once(endpoint: str) -> None:
    with pytest.raises(cogradar.BadInput, match=f"^endpoint: '{endpoint}' is no endpoint, such as tcp/127.0.0.1:7447"):
        cogradar.connect(endpoint)
