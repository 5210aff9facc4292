"""The world of an array against one built by loops: all targets, at their directions, in every look."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.document import ScenarioError
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.plugins.kinds import SIGNAL
from cogradar.shared.scenario.plugins.resolver import resolve
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.world_config import WorldEchoSection
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from cogradar.shared.signal.looks import NO_RANGE, Look
from cogradar.shared.signal.radar_equation import amplitude_at_1_km
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import beam_factor, root
from cogradar.shared.world.array_scene import ArrayScene
from cogradar.shared.world.disturbance import draw
from cogradar.shared.world.scene import Scene
from cogradar.shared.world.targets import echo_amplitudes
from tests.oracles.detection import literal_cell

Complexes = NDArray[np.complex128]

SEED, WIDTH, K = 3, 0.5, 4
BINS = load("smoke", ["world.signal=array"])
STEERED = load("smoke", ["world.signal=array", "radar.fidelity=best"])
RANGED = load("smoke", ["world.signal=array", "radar.fidelity=best-range"])
ARRAY = BINS.radar.array
NOTHING = np.empty((ARRAY.n_tx, 0), dtype=np.complex128)
LIMIT = threshold(1e-4)
WAVEFORMS = {"isotropic": (1.0, NOTHING), "beams": (0.3, beam_factor(np.array([-0.3, 0.17]), np.full(2, 0.35), 16))}


def look_at(nu: float, cells: Sequence[int] = (), limit: float = LIMIT) -> Look:
    return Look(nu, int(angle_bin(nu, ARRAY.n_bin)), cells, limit)


def scene_of(scenario: Scenario, seed: int = SEED, t: int = 0, **world: Any) -> ArrayScene:
    return ArrayScene(scenario.simulated.model_copy(update=world), scenario.radar, seed, t)


def silent(scenario: Scenario, seed: int = SEED) -> ArrayScene:
    return scene_of(scenario, seed, echo=WorldEchoSection.model_construct(amplitude_db=-300.0))


def signature(w: Complexes, nu: float) -> Complexes:
    return np.kron(w.T @ steering_vector(nu, ARRAY.n_tx), steering_vector(nu, ARRAY.n_rx)).astype(np.complex128)


def built_by_loops(scene: ArrayScene, scenario: Scenario, waveform: tuple[float, Complexes], cell: int) -> Complexes:
    """Y of a range cell, entry by entry."""
    world = scenario.simulated
    at_1_km = amplitude_at_1_km(world.echo.amplitude_db)
    alphas = echo_amplitudes(scene.states, at_1_km, len(world.targets) * ["constant"], SEED, K)
    nus, w = spatial_frequency(scene.states), root(*waveform)
    rng = generator(SEED, Purpose.DISTURBANCE, (cell - NO_RANGE) << 16, K)
    y = draw(world.disturbance.model, ARRAY.n_tx * ARRAY.n_rx, rng).reshape(ARRAY.n_tx, ARRAY.n_rx)
    for alpha, nu, range_km in zip(alphas, nus, scene.range_km, strict=True):
        share = 1.0
        if cell != NO_RANGE:
            off = range_km / WIDTH - (cell + 0.5)
            share = np.sin(np.pi * off) / (np.pi * off) if abs(off) < 1.0 else 0.0
        sent = w.T @ steering_vector(nu, ARRAY.n_tx)
        for i in range(ARRAY.n_tx):
            for r in range(ARRAY.n_rx):
                y[i, r] += alpha * share * sent[i] * np.exp(2j * np.pi * nu * r)
    return y.ravel()


@pytest.mark.parametrize("waveform", WAVEFORMS.values(), ids=WAVEFORMS)
def test_every_look_is_the_test_of_what_the_whole_array_received(waveform: tuple[float, Complexes]) -> None:
    scene = scene_of(BINS)
    y, w = built_by_loops(scene, BINS, waveform, NO_RANGE), root(*waveform)
    looks = [look_at(nu) for nu in bin_centres(ARRAY.n_bin).tolist()]
    for one in scene.observe(K, *waveform, looks):
        nu = one.look.nu
        v = signature(w, nu)
        assert one.cell == pytest.approx(literal_cell(y, v), rel=1e-7)
        assert (one.nu_hat, one.nu_sigma, one.range_km) == (nu, 0.0, 0.0)


@pytest.mark.parametrize("waveform", WAVEFORMS.values(), ids=WAVEFORMS)
def test_a_target_is_in_two_range_cells(waveform: tuple[float, Complexes]) -> None:
    scene = scene_of(RANGED)
    nu, place = float(spatial_frequency(scene.states)[0]), float(scene.range_km[0]) / WIDTH - 0.5
    w, cells = root(*waveform), (int(place), int(place) + 1)
    v = signature(w, nu)
    for cell in cells:
        (one,) = scene.observe(K, *waveform, [look_at(nu, [cell], limit=np.inf)])
        assert one.range_km == (cell + 0.5) * WIDTH
        assert one.cell == pytest.approx(literal_cell(built_by_loops(scene, RANGED, waveform, cell), v), rel=1e-7)
    rows = scene.observe(K, *waveform, [look_at(nu, range(cells[0] - 20, cells[0] + 20), limit=3.0)])
    both = {(cell + 0.5) * WIDTH for cell in cells}
    assert len(both & {one.range_km for one in rows}) == 1  # it is reported once


def test_an_echo_is_as_strong_as_it_is_far_whatever_the_look() -> None:
    """The amplitude of a look at the target, less that of the disturbance, is alpha; beside it, the sidelobe's."""
    scene, noise = scene_of(BINS, targets=BINS.simulated.targets[:1]), silent(BINS)
    nu = float(spatial_frequency(scene.states)[0])
    looks = [look_at(nu + d) for d in (-2.5 / 16, 0.0, 0.4 / 16)]
    (alpha,) = echo_amplitudes(scene.states, amplitude_at_1_km(70.0), ["constant"], SEED, K)
    for one, other in zip(scene.observe(K, 1.0, NOTHING, looks), noise.observe(K, 1.0, NOTHING, looks), strict=True):
        heard = np.vdot(steering_vector(one.look.nu, 16), steering_vector(nu, 16)) / 16
        assert one.cell.alpha_hat - other.cell.alpha_hat == pytest.approx(alpha * heard**2, rel=1e-9)


def test_elements_lose_towards_end_fire_as_their_pattern_says() -> None:
    patterned = load("smoke", ["world.signal=array", "world.array.pattern_exponent=1.5"])
    plain, weaker, noise = scene_of(BINS), scene_of(patterned), silent(BINS)
    for m, nu in enumerate(spatial_frequency(plain.states).tolist()):
        alone = BINS.simulated.targets[m : m + 1]
        scenes = (scene_of(BINS, targets=alone), scene_of(patterned, targets=alone), noise)
        full, less, none = (scene.observe(K, 1.0, NOTHING, [look_at(nu)])[0].cell.alpha_hat for scene in scenes)
        angle = np.arctan2(weaker.states[m, 2], weaker.states[m, 0])
        assert (less - none) / (full - none) == pytest.approx(np.cos(angle) ** 1.5, rel=1e-9)


def test_false_alarms_are_as_often_as_the_limit_says() -> None:
    """10^4 channels of the paper's disturbance without targets: 5 sigma of as many independent tests."""
    paper, p, dwells = load("paper", ["world.signal=array"]), 1e-2, 200
    scene, array = silent(paper), paper.radar.array
    nus = bin_centres(array.n_bin)[:-1].tolist()  # the last is the first again
    looks, everywhere = [look_at(nu, limit=threshold(p)) for nu in nus], np.empty((array.n_tx, 0), np.complex128)
    cells = [one for k in range(dwells) for one in scene.observe(k, 1.0, everywhere, looks)]
    low, high = binom.interval(1.0 - 5.7e-7, dwells * len(looks), p)
    assert low <= sum(one.cell.statistic >= one.look.limit for one in cells) <= high


def test_both_ends_are_one_direction() -> None:
    near = BINS.simulated.targets[0].model_copy(update={"state": [0.5, 0.0, 40.0, 0.0]})
    first, last = scene_of(BINS, targets=[near]).observe(K, 1.0, NOTHING, [look_at(-0.5), look_at(0.5)])
    assert first.cell == pytest.approx(last.cell, rel=1e-9)
    assert first.cell.statistic > LIMIT


def test_looks_do_not_depend_on_each_other_or_on_what_was_asked_before() -> None:
    scene = scene_of(RANGED)
    own = int(scene.range_km[0] / WIDTH)
    nus = [*spatial_frequency(scene.states).tolist(), 0.31, -0.1]
    looks = [look_at(nu, range(own - 5, own + 5), limit=8.0) for nu in sorted(nus)]
    for waveform in WAVEFORMS.values():
        together = scene.observe(K, *waveform, looks)
        scene.observe(K + 1, *waveform, looks)
        again = scene_of(RANGED)
        again.prepare(K, [(0, own), (0, own + 1), (3, own)])
        apart = [one for look in reversed(looks) for one in reversed(again.observe(K, *waveform, [look]))][::-1]
        assert [(one.look, one.range_km) for one in apart] == [(one.look, one.range_km) for one in together]
        for one, other in zip(apart, together, strict=True):
            assert one.cell == pytest.approx(other.cell, rel=1e-9)
        assert again.observe(K, *waveform, looks) == together


def test_data_sets_that_are_not_kept_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(RANGED)
    gate = range(int(scene.range_km[0] / WIDTH) - 5, int(scene.range_km[0] / WIDTH) + 5)
    looks = [look_at(nu, gate, limit=8.0) for nu in sorted(spatial_frequency(scene.states).tolist())]
    rows = scene.observe(K, 1.0, NOTHING, looks)
    monkeypatch.setattr("cogradar.shared.world.array_scene.KEPT_BYTES", 1)
    assert scene_of(RANGED).observe(K, 1.0, NOTHING, looks) == rows
    assert any(one.nu_sigma > 0.0 for one in rows)


@pytest.mark.parametrize("scenario", [BINS, STEERED], ids=["bins", "steered"])
def test_only_the_detections_of_steered_cells_have_a_measured_direction(scenario: Scenario) -> None:
    scene = scene_of(scenario)
    nu = float(spatial_frequency(scene.states)[0])
    (one,) = scene.observe(K, 0.0, beam_factor(np.array([nu]), np.ones(1), 16), [look_at(nu + 0.01)])
    assert one.cell.statistic > LIMIT
    assert (one.nu_sigma > 0.0) == (scenario is STEERED)
    if scenario is STEERED:
        assert abs(one.nu_hat - nu) < 5.0 * one.nu_sigma


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("world.signal=arrays", "--set world.signal=arrays: must be one of cells, array"),
        (
            "world.array.pattern_exponent=1.0",
            'world: signal = "cells": array must be left out, or set world.signal = "array"',
        ),
        ("world.array.pattern_exponent=-1.0", "world.array.pattern_exponent=-1.0: must be a number >= 0 and <= 10"),
    ],
)
def test_a_signal_that_cannot_be_is_refused(setting: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(said)):
        load("smoke", [setting])


@pytest.mark.parametrize("scenario", [STEERED, RANGED, load("smoke", ["radar.fidelity=best-range"])])
def test_a_target_at_a_height_is_measured_as_one_in_the_plane_at_its_distance_from_the_line(scenario: Scenario) -> None:
    """The same range and direction, so the same scan; a target on the ground below it gives another one."""

    def scan(height_km: float, x: float) -> list[Any]:
        target = scenario.simulated.targets[0].model_copy(update={"state": [x, 0.0, 30.0, 0.0], "height_km": height_km})
        world = scenario.simulated.model_copy(update={"targets": [target], "rcs": "constant"})
        scene: Scene = resolve(SIGNAL, world.signal)(world, scenario.radar, SEED, 0)
        assert scene.states[0, 0] == x
        cells = range(60, 120) if scenario is not STEERED else ()
        looks = [look_at(nu, cells) for nu in (0.3, 0.32, 0.34, 0.36)]
        return [scene.snr_db, scene.target_bins, *scene.observe(K, 1.0, NOTHING, looks)]

    high, flat, below = scan(9.0, 12.0), scan(0.0, 15.0), scan(0.0, 12.0)
    assert repr(high) == repr(flat) != repr(below)
