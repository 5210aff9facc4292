"""Steered cells: targets are heard where they are, in their own range cells; what is drawn for empty cells."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.stats import ks_2samp, kstest

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.world_config import WorldEchoSection
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.looks import NO_RANGE, Look, Measured
from cogradar.shared.signal.monopulse import off_axis_loss
from cogradar.shared.signal.radar_equation import amplitude_at_1_km
from cogradar.shared.signal.receiver import threshold, wald_test
from cogradar.shared.signal.waveform import Signatures, transmit_signatures
from cogradar.shared.world.cell_scene import CellScene
from cogradar.shared.world.disturbance import draw
from cogradar.shared.world.targets import echo_amplitudes

SEED, WIDTH = 3, 0.5
MONOPULSE = Processing(is_steered=True, monopulse=True)


STEERED = load("smoke", ["radar.fidelity=best"])
RANGED = load("smoke", ["radar.fidelity=best-range"])
ARRAY = STEERED.radar.array
AT_1_KM = amplitude_at_1_km(STEERED.simulated.echo.amplitude_db)
REACH = 1.0 / ARRAY.n_rx
EVERYWHERE = np.empty((ARRAY.n_tx, 0), dtype=np.complex128)
SPREAD = np.sqrt(1.0 / ARRAY.n_tx) * np.eye(ARRAY.n_tx, dtype=np.complex128)  # the same power, each look reported


_VALUES: tuple[Callable[[Measured], float], ...] = (
    lambda one: one.cell.statistic,
    lambda one: abs(one.cell.alpha_hat),
    lambda one: float(np.angle(one.cell.alpha_hat)),
    lambda one: one.nu_hat,
    lambda one: one.nu_sigma,
)


def look_at(nu: float, cells: Sequence[int] = (), limit: float = 18.0) -> Look:
    return Look(nu, int(angle_bin(nu, ARRAY.n_bin)), cells, limit)


def scene_of(scenario: Scenario, *, is_silent: bool = False, **world: object) -> CellScene:
    if is_silent:
        world["echo"] = WorldEchoSection.model_construct(amplitude_db=-300.0)
    return CellScene(scenario.simulated.model_copy(update=world), scenario.radar, SEED, 0)


def seen(scenario: Scenario, looks: Sequence[Look], isotropic: float = 0.0, k: int = 4) -> list[Measured]:
    """What a scene at t = 0 reports, with power in all directions, whatever is said of it."""
    return scene_of(scenario).observe(k, isotropic, EVERYWHERE if isotropic else SPREAD, looks)


def test_a_target_is_heard_in_the_main_lobes_that_it_is_in_with_what_they_lose() -> None:
    scene, silent = scene_of(STEERED), scene_of(STEERED, is_silent=True)
    nu = float(spatial_frequency(scene.states)[0])
    offsets = REACH * np.array([-1.2, -1.001, -0.999, -0.5, -0.1, 0.0, 0.3, 0.8, 1.001, 1.7])
    looks = [look_at(nu + d) for d in offsets.tolist()]
    echoes = [
        abs(one.cell.alpha_hat - noise.cell.alpha_hat)
        for one, noise in zip(*(s.observe(4, 0.0, SPREAD, looks) for s in (scene, silent)), strict=True)
    ]
    alpha = abs(echo_amplitudes(scene.states, AT_1_KM, len(scene.states) * ["constant"], SEED, 4)[0])
    expected = alpha * off_axis_loss(offsets, ARRAY.n_tx) * off_axis_loss(offsets, ARRAY.n_rx)
    np.testing.assert_allclose(echoes, np.where(np.abs(offsets) < REACH, expected, 0.0), atol=1e-9)


def test_targets_in_one_main_lobe_add_up() -> None:
    first = STEERED.simulated.targets[0].begin
    beside = [first[0], first[1], first[2] + 0.02 * first[0], first[3]]
    pair = [STEERED.simulated.targets[0].model_copy(update={"state": state}) for state in (first, beside)]
    both, silent = scene_of(STEERED, targets=pair), scene_of(STEERED, targets=pair, is_silent=True)
    nus = spatial_frequency(both.states)
    look = look_at(float(nus.mean()))
    (cell,), (noise,) = (scene.observe(4, 1.0, EVERYWHERE, [look]) for scene in (both, silent))
    alphas = echo_amplitudes(both.states, AT_1_KM, 2 * ["constant"], SEED, 4)
    v, *of_targets = (
        np.kron(transmit_signatures(1.0, EVERYWHERE, np.array([nu]))[0], steering_vector(nu, ARRAY.n_rx))
        for nu in (look.nu, *nus)
    )
    expected = np.vdot(v, sum(a * w for a, w in zip(alphas, of_targets, strict=True))) / np.vdot(v, v)
    assert cell.cell.alpha_hat - noise.cell.alpha_hat == pytest.approx(expected, rel=1e-9)


def test_a_steered_cell_in_a_bin_s_centre_meets_the_bin_s_disturbance() -> None:
    plain = load("smoke")
    looks = [look_at(float(nu)) for nu in bin_centres(ARRAY.n_bin)]
    bins, cells = (
        scene_of(scenario, is_silent=True).observe(4, 1.0, EVERYWHERE, looks) for scenario in (plain, STEERED)
    )
    assert [one.cell for one in bins] == [one.cell for one in cells]


def test_a_target_is_heard_in_its_own_range_cell_alone() -> None:
    scene = scene_of(RANGED)
    nu, range_km = float(spatial_frequency(scene.states)[0]), float(scene.range_km[0])
    own = int(range_km / WIDTH)
    (there,) = seen(RANGED, [look_at(nu, [own])])
    assert there.range_km == (own + 0.5) * WIDTH
    assert there.cell.statistic > 100.0
    for gate in ([own - 1], [own + 1], range(own - 9, own)):
        (elsewhere,) = seen(RANGED, [look_at(nu, gate)])
        assert elsewhere.cell.statistic < 30.0
        assert elsewhere.range_km in {(i + 0.5) * WIDTH for i in gate}
    (of_gate,) = seen(RANGED, [look_at(nu, range(own - 3, own + 5))])
    assert of_gate == there._replace(look=of_gate.look)


def test_two_targets_of_one_look_have_a_row_each_unless_all_bins_are_tested() -> None:
    first = RANGED.simulated.targets[0].begin
    beyond = [1.03 * x if i in {0, 2} else x for i, x in enumerate(first)]
    pair = [RANGED.simulated.targets[0].model_copy(update={"state": state}) for state in (first, beyond)]
    crowded = RANGED.model_copy(update={"world": RANGED.simulated.model_copy(update={"targets": pair})})
    scene = scene_of(crowded)
    cells = (scene.range_km / WIDTH).astype(int)
    look = look_at(float(spatial_frequency(scene.states)[0]), range(int(cells.min()) - 4, int(cells.max()) + 4))
    rows = seen(crowded, [look])
    assert {one.range_km for one in rows} == set(((cells + 0.5) * WIDTH).tolist())
    assert rows == sorted(rows, key=lambda one: -one.cell.statistic)
    assert [one.cell for one in seen(crowded, [look._replace(is_merged=True)])] == [rows[0].cell]


def test_range_cells_of_a_bin_meet_disturbance_of_their_own() -> None:
    scene = scene_of(RANGED)
    drawn = [scene._disturbance((5, cell), 4) for cell in (NO_RANGE, 0, 1, 399)]
    assert np.array_equal(drawn[0], scene_of(STEERED)._disturbance((5, NO_RANGE), 4))
    law = RANGED.simulated.disturbance.model, drawn[0].size
    assert np.array_equal(drawn[0], draw(*law, generator(SEED, Purpose.DISTURBANCE, 5, 4)))
    assert len({vector.tobytes() for vector in drawn}) == 4


@pytest.mark.parametrize("guess", [[], [(7, NO_RANGE), (3, 40)], "as it was"])
def test_what_was_prepared_changes_nothing(guess: list[tuple[int, int]] | str) -> None:
    """Two looks of one bin share its disturbance: the first must not leave its echo in it."""
    scene = scene_of(RANGED)
    nu, own = float(spatial_frequency(scene.states)[0]), int(scene.range_km[0] / WIDTH)
    looks = sorted(look_at(nu + d, range(own - 4, own + 4)) for d in (0.0, 0.1 * REACH, 0.2 * REACH))
    assert len({look.bin for look in looks}) < 3
    factor = np.eye(ARRAY.n_tx, dtype=np.complex128)
    prepared = scene_of(RANGED)
    for k in range(5, 8):
        prepared.prepare(k, prepared.drawn if isinstance(guess, str) else guess)
        assert prepared.observe(k, 0.0, factor, looks) == scene.observe(k, 0.0, factor, looks)


@pytest.mark.parametrize(("model", "nu"), [("white", 0.31), ("ar6-t", 0.21)])
def test_the_largest_of_empty_cells_is_distributed_as_cell_by_cell(model: str, nu: float) -> None:
    """Statistic, amplitude, measured direction and place; as many antennas receive as the spectrum's peaks need.

    In other directions the receiver's own estimate of the disturbance is biased at this size, by up to 15 %.
    """
    size = [f"radar.array.{name}" for name in ("n_tx=8", "n_rx=100")]
    scenario = load("smoke", ["radar.fidelity=best-range", *size, f"world.disturbance.model={model}"])
    n, n_draw, rng = 12, 400, np.random.default_rng(5)
    look, factor = look_at(nu, range(100, 100 + n), limit=1e-9), np.eye(8, dtype=np.complex128)
    scene, signatures = scene_of(scenario), Signatures(0.0, factor, 100)
    assert np.abs(spatial_frequency(scene.states) - nu).min() > 0.01
    found = [scene.observe(k, 0.0, factor, [look])[0] for k in range(n_draw)]
    simulated = []
    for _ in range(n_draw):
        cells = [draw(model, 800, rng) for _ in range(n)]
        loudest = max(cells, key=lambda y: wald_test(y, *signatures.at(nu)).statistic)
        simulated.append(DataSet(loudest, signatures, MONOPULSE).measure(look, 0.0))
    for value in _VALUES:
        drawn, expected = ([value(one) for one in some] for some in (found, simulated))
        assert ks_2samp(drawn, expected).pvalue > 1e-3
    assert found[0].cell.signature_power == pytest.approx(simulated[0].cell.signature_power)
    places = np.array([one.range_km for one in found]) / WIDTH - 0.5
    assert kstest(places + rng.random(n_draw), "uniform", (100, n)).pvalue > 1e-3


def test_false_alarms_of_a_look_are_as_rare_as_of_one_cell() -> None:
    n, p_fa, n_draw = 64, 0.05, 2000
    scene = scene_of(RANGED)
    nu = 0.5 * float(np.sort(spatial_frequency(scene.states))[:2].sum())
    look = look_at(nu, range(n), threshold(p_fa, n))
    factor = np.eye(ARRAY.n_tx, dtype=np.complex128)
    alarms = sum(scene.observe(k, 0.0, factor, [look])[0].nu_sigma > 0.0 for k in range(n_draw))
    assert alarms == pytest.approx(n_draw * p_fa, abs=4.0 * np.sqrt(n_draw * p_fa))
