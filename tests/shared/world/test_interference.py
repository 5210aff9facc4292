"""Jammers and clutter in the data sets of an array, against what their definitions say."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, kstest

from cogradar.shared.scenario.document import ScenarioError
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import ArraySection
from cogradar.shared.scenario.world_config import ClutterSection, JammerSection, WorldEchoSection
from cogradar.shared.signal.array import angle_bin, bin_centres, steering_vector
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.waveform import Signatures, beam_factor, root
from cogradar.shared.world.array_scene import ArrayScene
from cogradar.shared.world.interference import Clutter, Jammer, Source

Complexes = NDArray[np.complex128]

Waveform = tuple[float, Complexes]  # isotropic power, and a column for each beam

SEED, ARRAY = 3, ArraySection(n_tx=16, n_rx=12, n_bin=16, power=2.0)
NOTHING = np.empty((16, 0), dtype=np.complex128)
EVERYWHERE = 2.0, NOTHING
IN_ARRAY = "world.signal=array"


def added(source: Source, k: int, range_cell: int, waveform: Waveform, time_s: float = 0.0) -> Complexes:
    """What a source adds to a data set of nothing, (n_tx, n_rx)."""
    y = np.zeros((ARRAY.n_tx, ARRAY.n_rx), dtype=np.complex128)
    add = source.during(k, time_s, Signatures(*waveform, ARRAY.n_rx))
    assert add is not None
    add(y, range_cell)
    return y


def received(jammer: Jammer, n: int = 1, range_cell: int = 7, time_s: float = 0.0) -> Complexes:
    """What a jammer adds in n dwells, (n, n_tx, n_rx)."""
    return np.array([added(jammer, k, range_cell, EVERYWHERE, time_s) for k in range(n)])


def jammer_of(**given: Any) -> Jammer:
    return Jammer(JammerSection(**given), 0, SEED)


def clutter_of(pattern_exponent: float = 0.0, **given: Any) -> Clutter:
    return Clutter(ClutterSection(**given), ARRAY, pattern_exponent, SEED)


def test_a_jammer_is_noise_from_its_direction_with_its_power_at_each_element() -> None:
    y = received(jammer_of(bearing_deg=30.0, jnr_db=13.0), 400)
    along = y * steering_vector(0.25, ARRAY.n_rx).conj()  # nu = 0.5 sin(30 deg)
    np.testing.assert_allclose(along, np.broadcast_to(along[..., :1], along.shape), atol=1e-12)
    g = along[..., 0].ravel() / 10.0 ** (13.0 / 20.0)
    assert kstest(2.0 * np.abs(g) ** 2, chi2(2).cdf).pvalue > 1e-3
    assert abs(np.mean(g[1:] * g[:-1].conj())) < 5.0 / np.sqrt(g.size)


def test_a_jammer_s_place_gives_its_direction() -> None:
    at, towards = jammer_of(place_km=[40.0, -30.0], jnr_db=0.0), jammer_of(bearing_deg=-36.86989764584402, jnr_db=0.0)
    np.testing.assert_allclose(received(at), received(towards), rtol=1e-9)


def test_a_jammer_has_noise_of_its_own_in_each_range_cell_and_dwell_and_only_in_its_time() -> None:
    jammer = jammer_of(bearing_deg=0.0, jnr_db=0.0, on_s=3.0, off_s=5.0)
    signatures = Signatures(*EVERYWHERE, ARRAY.n_rx)
    is_on = [jammer.during(0, t, signatures) is not None for t in (0.0, 2.9, 3.0, 4.9, 5.0, 9.0)]
    assert is_on == [False, False, True, True, False, False]
    assert jammer_of(bearing_deg=0.0, jnr_db=0.0).during(0, 1e6, signatures) is not None
    other = Jammer(JammerSection(bearing_deg=0.0, jnr_db=0.0), 1, SEED)
    different = [*received(jammer, 3, 7, 3.0), *received(jammer, 2, -1, 3.0), *received(other, 1)]
    assert len({y.tobytes() for y in different}) == 6


def test_clutter_has_its_power_while_the_power_goes_everywhere_and_follows_a_beam() -> None:
    clutter = clutter_of(cnr_db=-7.0, patches=50)
    beam = 0.0, beam_factor(np.array([0.2]), np.array([2.0]), ARRAY.n_tx)
    for waveform, expected in (EVERYWHERE, 10.0**-0.7), ((1.0, NOTHING), 0.5 * 10.0**-0.7):
        y = np.array([added(clutter, 4, cell, waveform) for cell in range(600)])
        assert np.mean(np.abs(y) ** 2) == pytest.approx(expected, rel=0.06)
    nus = np.linspace(-0.5, 0.5, 201)
    y = np.array([added(clutter, 4, cell, beam) for cell in range(100)])
    heard = np.sum(np.abs(y @ steering_vector(nus, ARRAY.n_rx).conj().T) ** 2, axis=(0, 1))
    assert nus[np.argmax(heard)] == pytest.approx(0.2, abs=0.03)


def test_clutter_is_the_sum_of_its_patches_as_the_waveform_lights_them() -> None:
    clutter = clutter_of(cnr_db=3.0, patches=5)
    waveform = 0.7, beam_factor(np.array([0.2, -0.4]), np.array([0.8, 0.5]), ARRAY.n_tx)
    w, expected = root(*waveform), np.zeros((16, 12), np.complex128)
    for gamma, degrees in zip(clutter.echoes(8, 6), (-72.0, -36.0, 0.0, 36.0, 72.0), strict=True):
        nu = 0.5 * np.sin(np.radians(degrees))
        expected += gamma * np.outer(w.T @ steering_vector(nu, 16), steering_vector(nu, 12))
    np.testing.assert_allclose(added(clutter, 6, 8, waveform), expected, atol=1e-12)


@pytest.mark.parametrize("correlation", [0.5, 0.95])
def test_clutter_changes_slowly_as_a_first_order_autoregression(correlation: float) -> None:
    clutter = clutter_of(cnr_db=0.0, patches=200, correlation=correlation)
    echoes = {k: np.concatenate([clutter.echoes(cell, k) for cell in range(100)]) for k in (1000, 1001, 1004)}
    power = float(np.mean(np.abs(echoes[1000]) ** 2))
    for lag in (1, 4):
        measured = np.mean(echoes[1000] * echoes[1000 + lag].conj()) / power
        assert measured == pytest.approx(correlation**lag, abs=5.0 / np.sqrt(20_000))


def test_clutter_that_never_changes_and_elements_that_lose_towards_end_fire() -> None:
    still = clutter_of(cnr_db=0.0, patches=9, correlation=1.0)
    assert np.array_equal(still.echoes(3, 0), still.echoes(3, 900))
    angles = np.pi * ((np.arange(9) + 0.5) / 9 - 0.5)
    weaker = clutter_of(2.0, cnr_db=0.0, patches=9, correlation=1.0)
    np.testing.assert_allclose(weaker.echoes(3, 0), still.echoes(3, 0) * np.cos(angles) ** 2, rtol=1e-12)


def silent_scene(*settings: str) -> ArrayScene:
    scenario = load("smoke", [IN_ARRAY, *settings])
    echo = WorldEchoSection.model_construct(amplitude_db=-300.0)
    return ArrayScene(scenario.simulated.model_copy(update={"echo": echo}), scenario.radar, SEED, 0)


def looks_at(nus: list[float], cells: range = range(0)) -> list[Look]:
    return [Look(nu, int(angle_bin(nu, 16)), cells, 18.0) for nu in nus]


def test_a_jammer_is_in_every_range_cell_of_a_look_while_it_is_on() -> None:
    jammers = "world.jammers=[{bearing_deg = 0.0, jnr_db = 30.0, on_s = 1.0}]"
    scenes = silent_scene("radar.fidelity=best-range"), silent_scene("radar.fidelity=best-range", jammers)
    looks = looks_at([0.0], range(20, 60))
    quiet, jammed = (scene.observe(2, 1.0, NOTHING, looks) for scene in scenes)
    assert quiet == jammed  # at t = 0 it is off
    for scene in scenes:
        scene.move()
    quiet, jammed = (scene.observe(2, 1.0, NOTHING, looks) for scene in scenes)
    assert abs(jammed[0].cell.alpha_hat) > 10.0 * abs(quiet[0].cell.alpha_hat)
    assert len(scenes[1].drawn) == 40


def test_a_jammer_blinds_the_test_beside_its_direction() -> None:
    """The sum over ten lags is negative in many directions: what a receiver for arrays has to cure."""
    scene = silent_scene("world.jammers=[{bearing_deg = 0.0, jnr_db = 20.0}]", "radar.array.n_bin=32")
    looks = looks_at(bin_centres(32).tolist())
    cells = [one.cell for k in range(10) for one in scene.observe(k, 1.0, NOTHING, looks)]
    assert np.mean([cell.sigma_hat == 0.0 for cell in cells]) > 0.2


def test_clutter_raises_false_alarms_by_its_power() -> None:
    looks = looks_at(bin_centres(16)[:-1].tolist())
    rates = []
    for cnr_db in (-40.0, 0.0):
        scene = silent_scene(f"world.clutter={{cnr_db = {cnr_db}}}")
        rows = [one for k in range(60) for one in scene.observe(k, 1.0, NOTHING, looks)]
        rates.append(np.mean([one.cell.statistic > 9.2 for one in rows]))  # P_FA = 1e-2
    assert rates[0] < 0.05
    assert rates[1] > 0.3


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("world.jammers=[{jnr_db = 3.0}]", "must have bearing_deg or place_km, has neither"),
        ("world.jammers=[{jnr_db = 3.0, bearing_deg = 1.0, place_km = [1.0, 1.0]}]", "has both"),
        ("world.jammers=[{jnr_db = 3.0, bearing_deg = 91.0}]", "bearing_deg = 91.0: must be a number >= -90 and <= 90"),
        ("world.jammers=[{jnr_db = 3.0, place_km = [-1.0, 1.0]}]", "x must be >= 0: it is behind the array"),
        ("world.jammers=[{jnr_db = 3.0, bearing_deg = 0.0, on_s = 5.0, off_s = 5.0}]", "off_s = 5 must be above on_s"),
        ("world.clutter={cnr_db = 3.0, correlation = 0.0}", "correlation = 0.0: must be a number > 0 and <= 1"),
        ("world.clutter={cnr_db = 3.0, patches = 0}", "patches = 0: must be an integer >= 1 and <= 1000"),
    ],
)
def test_what_cannot_be_is_refused(setting: str, said: str) -> None:
    with pytest.raises(ScenarioError) as refusal:
        load("smoke", [IN_ARRAY, setting])
    assert said in str(refusal.value)


def test_independent_cells_have_no_place_for_interference() -> None:
    with pytest.raises(ScenarioError) as refusal:
        load("smoke", ["world.jammers=[{bearing_deg = 0.0, jnr_db = 3.0}]", "world.clutter={cnr_db = 3.0}"])
    assert str(refusal.value).endswith(
        'signal = "cells": jammers and clutter must be left out, or set world.signal = "array"'
    )
