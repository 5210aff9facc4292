"""Arrays of a run whose tracks come and go: by track, and still by target."""

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import cogradar
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.drawing.figures import draw_all
from cogradar.services.analysis.export.tables import scores
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.cli.display import run_caption
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.runs import in_process
from cogradar.services.runs.run import untold
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, RunStart, Truth
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.tracking.motion import mean_state
from tests.services.births import HERE, THERE, start_of
from tests.services.loop import play, smoke_start
from tests.services.web.unknown_run import DWELLS, sent

PLAYED = 10


def _stored(store: Store, messages: list[Message], run: str) -> Result:
    core = RecorderCore(store.journal)
    for message in messages:
        core.handle(message.model_copy(update={"run": run}))
    for _ in range(2):
        core.handle(Tick(0.0))
    return Result(StoredRun(partial(answer, store), run))


@pytest.fixture(scope="module")
def store() -> Iterator[Store]:
    made = in_memory()
    yield made
    made.close()


@pytest.fixture(scope="module")
def by_hand(store: Store) -> Result:
    return _stored(store, sent(), "by-hand")


def test_a_track_has_a_column_from_its_first_dwell_to_its_last(by_hand: Result) -> None:
    tracks = by_hand.by_track
    assert tracks.numbers.tolist() == [1, 2, 3]
    there = {n: by_hand.t[tracks.alive[:, n]].tolist() for n in range(3)}
    assert there == {0: list(range(2, DWELLS + 1)), 1: [4], 2: [7, 8, 9]}  # 5 and 10 are where the others end
    assert by_hand.t[tracks.confirmed[:, 2]].tolist() == [8, 9]
    assert np.array_equal(np.isnan(tracks.existence), ~tracks.alive)
    assert np.array_equal(np.isnan(tracks.estimates), np.repeat(~tracks.alive[..., None], 4, axis=-1))
    assert tracks.estimates[7, 2].tolist() == THERE
    assert tracks.shares[7].tolist() == pytest.approx([0.2, np.nan, 0.2], nan_ok=True)
    assert tracks.detections[3].tolist() == [True, False, False]
    assert tracks.targets[7].tolist() == [1, 0, 2]
    assert tracks.covariance.shape == (DWELLS, 3, 4, 4)


def test_arrays_by_target_have_the_track_that_follows_it_now(by_hand: Result) -> None:
    assert by_hand.estimates.shape == (DWELLS, 2, 4)
    assert by_hand.estimates[7].tolist() == [HERE, THERE]
    assert np.isnan(by_hand.estimates[10, 1]).all()
    assert np.isnan(by_hand.covariance[:, 1, 0, 0]).tolist() == np.isnan(by_hand.estimates[:, 1, 0]).tolist()
    assert by_hand.present[:, 1].sum() == 5
    assert by_hand.measured.statistic[7].tolist() == [100.0, 100.0]


def test_without_truth_there_are_tracks_alone(store: Store) -> None:
    start = start_of(DWELLS)
    blind = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    rest = [message for message in sent() if not isinstance(message, RunStart | Truth)]
    result = _stored(store, [blind, *rest], "blind")
    assert (result.t.tolist(), result.estimates.shape) == (list(range(1, DWELLS + 1)), (DWELLS, 0, 4))
    assert result.by_track.numbers.tolist() == [1, 2, 3]
    assert not result.by_track.targets.any()
    found = scores(result)
    assert (len(found["t"]), set(found["track"].tolist()), "x" in found) == (11 + 1 + 3, {1, 2, 3}, False)


def test_beliefs_are_those_of_the_planners(store: Store) -> None:
    result = _stored(store, play(start_of(PLAYED)), "played")
    tracks = result.by_track
    (last,) = np.flatnonzero(result.t == PLAYED)
    assert tracks.alive[last].any()
    for n in np.flatnonzero(tracks.alive[last]).tolist():
        particles = result.particles(None, PLAYED, track=int(tracks.numbers[n]))
        spread = np.sqrt(np.diag(tracks.covariance[last, n]))
        assert (np.abs(mean_state(particles) - tracks.estimates[last, n]) < 0.05 * spread).all()


def test_of_a_known_number_all_tracks_are_always_there(store: Store) -> None:
    result = _stored(store, play(smoke_start(dwells=4)), "known")
    tracks = result.by_track
    assert tracks.alive.all()
    assert tracks.confirmed.all()
    assert np.isnan(tracks.existence).all()
    assert np.array_equal(tracks.estimates[:, tracks.targets[0].argsort()], result.estimates)
    assert tracks.shares.sum(axis=1) == pytest.approx(result.shares.sum(axis=1))


def test_a_table_has_each_track_and_each_target_without_one(by_hand: Result) -> None:
    found = scores(by_hand)
    rows = list(zip(found["t"].tolist(), found["track"].tolist(), found["target"].tolist(), strict=True))
    assert rows[:6] == [(1, 0, 1), (2, 1, 0), (2, 0, 1), (3, 1, 1), (4, 1, 1), (4, 2, 0)]
    assert [row for row in rows if row[0] in {7, 8, 10}] == [
        *((7, 1, 1), (7, 3, 0), (7, 0, 2)),  # the third is tentative
        *((8, 1, 1), (8, 3, 2)),
        *((10, 1, 1), (10, 0, 2)),  # it has ended
    ]
    (at,) = np.flatnonzero((found["t"] == 8) & (found["track"] == 3))
    assert [found[name][at] for name in ("x", "y", "x_hat", "y_hat")] == [THERE[0], THERE[2]] * 2
    assert (found["confirmed"][at], found["existence"][at], found["detected"][at]) == (1, 0.9, 1)
    assert np.isnan(found["x_hat"][found["track"] == 0]).all()
    assert np.isnan(found["x"][found["target"] == 0]).all()
    assert {column.shape for column in found.values()} == {(len(rows),)}
    assert (found["true_bin"] < 0).tolist() == (found["target"] == 0).tolist()
    assert (found["hit"] < 0).tolist() == (found["target"] == 0).tolist()
    assert found["statistic"][at] == 100.0


def test_tables_of_both_kinds_have_one_order_of_columns(by_hand: Result, store: Store) -> None:
    known = list(scores(_stored(store, play(smoke_start(dwells=4)), "known-too")))
    unknown = [name for name in scores(by_hand) if name not in {"confirmed", "existence"}]
    assert [name for name in unknown if name in known] == known


def test_p_d_is_of_the_dwells_that_the_query_counts(by_hand: Result, store: Store) -> None:
    """Those since a track followed the target: the ones before are in the time to its confirmation."""
    rows = answer(store, "p_d", {"run": "by-hand"})
    assert [row["n"] for row in rows] == by_hand.scored.sum(axis=0).tolist()
    assert by_hand.scored.sum() < by_hand.present.sum()
    assert by_hand.p_d.tolist() == [row["p_d"] for row in rows]
    assert by_hand.p_d_interval[:, 0] == pytest.approx([row["p_d_low"] for row in rows])


def test_a_run_in_which_nobody_was_there_is_told_and_drawn(tmp_path: Path) -> None:
    nobody = RunStart.of(untold(load("nobody", ["dwells=8"])), Strategy.POWER_AWARE, 1, None)
    with closing(in_memory()) as store:
        caption = run_caption(in_process.play(nobody, store=store))
        (experiment,) = experiments(store, Selection())
        assert len(draw_all(store, experiment, tmp_path)) >= 6
    assert "completeness -, spuriousness -" in caption
    assert "no truth" not in caption


def test_a_run_without_any_track_has_tables_without_rows() -> None:
    """Nothing is planned in it, though all of it is stored."""
    seen = {"radar.fidelity": "best-range", "radar.tracks": "unknown", "world.echo.amplitude_db": -100.0}
    result = cogradar.run("smoke", set=seen, dwells=1)
    assert (result.detections().size, result.tracks().size, result.requests().size) == (0, 0, 0)
    assert (result.truth().size, result.waveforms().size) == (2, 1)
    assert result.by_track.numbers.size == 0
    assert np.isnan(result.covariance).all()
    assert result.covariance.shape == (1, 2, 4, 4)
