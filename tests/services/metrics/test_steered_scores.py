"""Scores of steered cells against the messages that they are made of, and every reader of their scans."""

import json
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from cogradar.services.analysis.arrays import result as run_arrays
from cogradar.services.analysis.export.tables import scores
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs import in_process
from cogradar.services.web.views import beampattern
from cogradar.services.web.views.dwells import Encoded, between
from cogradar.services.web.views.radar import facts
from cogradar.shared.protocol.messages import RunStart, Scan, Truth, Waveform
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.signal.monopulse import off_axis_loss
from cogradar.shared.wire.codec import decode

DWELLS, WIDTH = 24, 0.5
SCENARIO = load("smoke", ["radar.fidelity=best-range"])
N_RX, N_BIN = SCENARIO.radar.array.n_rx, SCENARIO.radar.array.n_bin


@pytest.fixture(scope="module", params=[Strategy.POWER_AWARE, Strategy.ORTHOGONAL])
def played(request: pytest.FixtureRequest) -> Iterator[tuple[Store, str]]:
    store = in_memory()
    yield store, in_process.play(RunStart.of(SCENARIO, request.param, 2, DWELLS), store=store).run["run"]
    store.close()


def _messages(store: Store, kind: type[Any]) -> dict[int, Any]:
    rows = store.read("SELECT k, payload FROM message WHERE topic = ?", [kind.__name__.lower()])
    return {row["k"]: decode(row["payload"]) for row in rows}


def _holding(scan: Any, state: Any) -> list[int]:
    """Rows in whose main lobe and range cell a target is."""
    nu, range_km = float(spatial_frequency(state)), float(np.hypot(state[0], state[2]))
    near = [i for i, at in enumerate(scan.nus) if abs(at - nu) < 1.0 / N_RX]
    return [i for i in near if int(scan.ranges_km[i] / WIDTH) == int(range_km / WIDTH)]


def test_a_target_is_detected_if_a_cell_that_holds_it_is_over_its_limit(played: tuple[Store, str]) -> None:
    store, _ = played
    scans, truths = _messages(store, Scan), _messages(store, Truth)
    rows = answer(store, "tracks", {})
    for row in rows:
        scan, state = scans[row["k"]], truths[row["k"]].states[row["target"] - 1]
        held = _holding(scan, state)
        assert row["detected"] == any(scan.statistic[i] >= scan.limits[i] for i in held)
        lit = scan.beam_nus[row["track"] - 1][scan.beams[row["track"] - 1] >= 0]
        assert row["hit"] == bool((np.abs(lit - spatial_frequency(state)) <= 0.5 / (N_BIN - 1)).any())
    assert np.mean([row["detected"] for row in rows]) > 0.4


def test_the_power_of_a_target_is_what_its_echo_met(played: tuple[Store, str]) -> None:
    store, _ = played
    scans, truths = _messages(store, Scan), _messages(store, Truth)
    for row in store.read("SELECT k, target, signature_power FROM score", []):
        nu = spatial_frequency(truths[row["k"]].states[row["target"] - 1])
        scan = scans[row["k"]]
        d = scan.nus - nu
        losses = (off_axis_loss(d, N_RX) * off_axis_loss(d, N_RX)) ** 2
        met = [p for p, at in zip(scan.signature_power * losses, d, strict=True) if abs(at) < 1.0 / N_RX]
        assert row["signature_power"] == pytest.approx(max(met, default=0.0))


def test_export_has_what_was_measured_of_each_target(played: tuple[Store, str]) -> None:
    store, run = played
    scans, truths = _messages(store, Scan), _messages(store, Truth)
    result = run_arrays.Result(StoredRun(partial(answer, store), run))
    columns, rows = scores(result), answer(store, "tracks", {})
    for i, row in enumerate(rows):
        scan = scans[row["k"]]
        held = _holding(scan, truths[row["k"]].states[row["target"] - 1])
        assert np.isnan(columns["statistic"][i]) == (not held)
        if not row["detected"]:
            assert np.isnan([columns[name][i] for name in ("nu_measured", "range_measured_km")]).all()
            continue
        at = max(held, key=lambda j: scan.statistic[j])
        for name, column in (
            ("statistic", "statistic"),
            ("nu_measured", "nu_hats"),
            ("range_measured_km", "ranges_km"),
        ):
            assert columns[name][i] == getattr(scan, column)[at]
        assert abs(columns["nu_measured"][i] - columns["nu"][i]) < 5.0 * columns["nu_measured_sigma"][i]
        assert abs(columns["range_measured_km"][i] - columns["range_km"][i]) <= 0.5 * WIDTH
    assert columns["detected"].sum() > 0.4 * len(rows)


def test_pages_show_beams_where_they_point_and_detections_elsewhere_as_false(played: tuple[Store, str]) -> None:
    store, run = played
    scans, truths, waveforms = (_messages(store, kind) for kind in (Scan, Truth, Waveform))
    known = facts(store, run)
    for t, data in between(store, known, Encoded(), 1, DWELLS, DWELLS):
        dwell = json.loads(data)
        scan, states = scans[dwell["k"]], truths[dwell["k"]].states
        held = {i for state in states for i in _holding(scan, state)}
        over = [i for i in range(scan.nus.size) if scan.statistic[i] >= scan.limits[i]]
        assert dwell["false_alarms"] == [scan.bins[i] for i in over if i not in held]
        shown = beampattern.of_dwell(store, known, t)["beams"]
        sent = waveforms[dwell["k"] - 1]
        assert sorted(one["nu"] for one in shown) == sorted(sent.nus[sent.beams >= 0].tolist())
        angles = np.degrees(np.arcsin(2.0 * np.array([one["nu"] for one in shown])))
        assert [one["angle_deg"] for one in shown] == pytest.approx(angles)
