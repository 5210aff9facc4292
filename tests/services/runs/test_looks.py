"""Lists of cells through the whole system: the same run in one process or several, under faults, in every reader."""

import json
from collections.abc import Callable, Iterator
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cogradar.services.analysis.arrays import result as run_arrays
from cogradar.services.analysis.export.tables import scores
from cogradar.services.analysis.replay import replay
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.services.runs.run import Result
from cogradar.services.web.views import beampattern
from cogradar.services.web.views.dwells import Encoded, between
from cogradar.services.web.views.radar import facts
from cogradar.shared.protocol.messages import Plan, RunStart, Scan, Waveform
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.runs.looks import SETTINGS

DWELLS = 20


def start_of(name: str, strategy: Strategy = Strategy.POWER_AWARE) -> RunStart:
    return RunStart.of(load("smoke", SETTINGS[name]), strategy, 1, DWELLS)


@pytest.fixture(scope="module", params=SETTINGS)
def played(request: pytest.FixtureRequest) -> Iterator[tuple[str, Store, Result]]:
    store = in_memory()
    yield request.param, store, in_process.play(start_of(request.param), store=store)
    store.close()


def messages(store: Store, kind: type[Any]) -> list[Any]:
    topic = kind.__name__.lower()
    rows = store.read("SELECT payload FROM message WHERE topic = ? ORDER BY k, item", [topic])
    return [decode(row["payload"]) for row in rows]


def test_planners_and_faults_change_nothing(played: tuple[str, Store, Result]) -> None:
    """A planner that is killed rebuilds its tracks, over dwells without a beam, too; some messages are lost."""
    name, _, alone = played
    start = start_of(name)
    assert in_process.play(start, planners=3).run["digest"] == alone.run["digest"]
    network = FaultyNetwork(start, 2, np.random.default_rng(1), loss=0.1)
    faults: dict[int, Callable[[], None]] = {
        200: partial(network.kill, "planner-0"),
        240: partial(network.start, "planner-0"),
    }
    assert play(network, faults) == alone.run["digest"]
    assert network.refused == []


def test_a_close_target_that_turns_hard_is_seen_in_every_dwell_if_looks_are_wide() -> None:
    detected = {}
    for wide in ("true", "false"):
        settings = (*SETTINGS["wide, joint"], f"radar.planner.wide_looks={wide}")
        store = in_memory()
        in_process.play(RunStart.of(load("smoke", settings), Strategy.POWER_AWARE, 1, 40), store=store)
        detected[wide] = np.mean([row["detected"] for row in answer(store, "tracks", {"target": "1"})])
        store.close()
    assert detected["true"] == 1.0
    assert detected["false"] < 0.97


def test_what_is_lit_is_what_was_asked_for_and_is_tested(played: tuple[str, Store, Result]) -> None:
    name, store, _ = played
    plans = {(plan.k, plan.target): plan for plan in messages(store, Plan)}
    waveforms = {waveform.k: waveform for waveform in messages(store, Waveform)}
    n_lit = []
    for scan in messages(store, Scan):
        if scan.t == 0:
            continue
        sent = waveforms[scan.k - 1]
        assert np.array_equal(scan.beams, sent.beams)
        assert sorted(set(scan.bins.tolist())) == sorted(set(scan.beams[scan.beams >= 0].tolist()))
        if scan.nus is not None:
            assert np.array_equal(scan.beam_nus, sent.nus)
            assert np.array_equal(scan.gates, sent.gates)
            assert set(scan.nus) == set(scan.beam_nus[scan.beams >= 0])
        assert sent.shares.sum() == pytest.approx(1.0, rel=1e-9)
        for track, row in enumerate(scan.beams):
            plan = plans[scan.k - 1, track]
            away = np.abs(row[row >= 0][:, np.newaxis] - plan.bins).min(axis=1)
            assert (away <= plan.reach + (scan.nus is not None)).all()  # directions a bin apart may be two bins apart
            assert scan.beam_nus is None or row[0] < 0 or scan.beam_nus[track, 0] in plan.nus
        n_lit += (scan.beams >= 0).sum(axis=1).tolist()
    assert max(n_lit) > (3 if name.startswith("wide") else 1)
    assert (min(n_lit) == 0) == name.startswith("urgency")


def test_every_reader_has_the_cells(played: tuple[str, Store, Result]) -> None:
    """Query, Python and export, of runs as they were stored; and a core that is fed with them answers the same."""
    name, store, alone = played
    rows = answer(store, "tracks", {})
    for row in rows:
        lit = [bin_ for bin_, _ in row["cells"]]
        assert row["bin"] == (lit[0] if lit else None)
        assert row["share"] == pytest.approx(sum(share for _, share in row["cells"]))
        assert row["hit"] == (row["true_bin"] in lit) or "best" in name
    stored = StoredRun(partial(answer, store), alone.run["run"])
    result = run_arrays.Result(stored)
    found = result.cells.reshape(len(rows), -1, 2)
    assert [cells[~np.isnan(cells[:, 0])].tolist() for cells in found] == [row["cells"] for row in rows]
    assert np.array_equal(result.bins, np.nan_to_num(result.cells[:, :, 0, 0], nan=-1.0))
    assert (result.best_bins == result.true_bins).ravel().tolist() == [r["best_bin"] == r["true_bin"] for r in rows]
    assert result.outages.ravel().tolist() == [row["outage"] for row in rows]
    assert scores(result)["share"].tolist() == result.shares.ravel().tolist()
    for core in ("planner", "allocator"):
        assert replay(stored, core).difference is None


def test_the_page_s_data_have_the_cells(played: tuple[str, Store, Result]) -> None:
    """One dwell as the page is told it: a beam per cell in the scope and in the pattern."""
    _, store, alone = played
    known = facts(store, alone.run["run"])
    ((t, data),) = between(store, known, Encoded(), DWELLS, DWELLS, 1)
    dwell = json.loads(data)
    rows = answer(store, "tracks", {"dwells": f"{t}:{t}"})
    assert [one["cells"] for one in dwell["targets"]] == [row["cells"] for row in rows]
    beams = sorted(beampattern.of_dwell(store, known, t)["beams"], key=itemgetter("target"))
    assert [(one["target"], one["bin"]) for one in beams] == [(r["target"], b) for r in rows for b, _ in r["cells"]]
    edges = [edge for one in dwell["targets"] for edge in one["beams_deg"]]
    assert all(low <= one["angle_deg"] <= high for one, (low, high) in zip(beams, edges, strict=True))


@pytest.mark.parametrize("name", ["joint", "best-range"])
def test_a_recording_of_lists_of_cells_is_played_back(name: str, tmp_path: Path) -> None:
    file, start = tmp_path / "runs.db", start_of(name)
    store = Store(Journal(str(file)))
    alone = in_process.play(start, store=store)
    store.close()
    blind = start_of(name)  # a recording knows no truth
    blind = blind.model_copy(update={"scenario": blind.scenario | {"world": None}})
    again = in_process.play(blind, front_end=f"recorded:{file}#{start.run}")
    assert again.run["digest"] == alone.run["digest"]
