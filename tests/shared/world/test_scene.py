"""The scene: a function of scenario, seed and what is transmitted, however and when it is worked out."""

import numpy as np
import pytest

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.world_config import WorldEchoSection
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.looks import NO_RANGE, Look
from cogradar.shared.signal.radar_equation import amplitude_at_1_km
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import beam_factor
from cogradar.shared.world.cell_scene import CellScene
from cogradar.shared.world.disturbance import draw
from cogradar.shared.world.scene import add_echo
from cogradar.shared.world.targets import echo_amplitudes

SMOKE, SEED = load("smoke"), 3
BEAM = beam_factor(np.array([0.1]), np.array([SMOKE.radar.array.power]), SMOKE.radar.array.n_tx)


def looks_at(*bins: int, radar: RadarConfig = SMOKE.radar) -> list[Look]:
    """Cells of the grid."""
    centres = bin_centres(radar.array.n_bin)
    return [Look(float(centres[bin_]), bin_, (), threshold(radar.detector.p_fa)) for bin_ in bins]


LOOKS = looks_at(3, 9)
ALL = looks_at(*range(SMOKE.radar.array.n_bin))


def test_a_scene_that_begins_later_is_where_the_others_came_to() -> None:
    scene = CellScene(SMOKE.simulated, SMOKE.radar, SEED, 0)
    assert np.array_equal(scene.states, SMOKE.simulated.initial_states())
    for t in range(1, 5):
        scene.move()
        assert scene.t == t
        assert np.array_equal(scene.states, CellScene(SMOKE.simulated, SMOKE.radar, SEED, t).states)
    assert not np.array_equal(scene.states, CellScene(SMOKE.simulated, SMOKE.radar, SEED + 1, 4).states)


def test_where_the_targets_are() -> None:
    scene = CellScene(SMOKE.simulated, SMOKE.radar, SEED, 0)
    x, y = scene.states[:, 0], scene.states[:, 2]
    assert np.allclose(scene.range_km, np.sqrt(x**2 + y**2))
    assert np.allclose(scene.snr_db, SMOKE.radar.echo.amplitude_db - 40.0 * np.log10(scene.range_km))
    assert len(set(scene.target_bins.tolist())) == SMOKE.radar.tracks


@pytest.mark.parametrize("guess", [[3, 9], [3], [0, 1, 2, 15], []])
def test_what_was_prepared_changes_nothing(guess: list[int]) -> None:
    """Whether the cells were guessed right, in part, wrong, or not at all."""
    plain, prepared = CellScene(SMOKE.simulated, SMOKE.radar, SEED, 2), CellScene(SMOKE.simulated, SMOKE.radar, SEED, 2)
    for k in range(5, 8):
        prepared.prepare(k, [(bin_, NO_RANGE) for bin_ in guess])
        for scene in (plain, prepared):
            scene.move()
        assert np.array_equal(prepared.states, plain.states)
        assert prepared.observe(k, 0.0, BEAM, LOOKS) == plain.observe(k, 0.0, BEAM, LOOKS)


def test_what_was_prepared_for_another_dwell_is_not_used() -> None:
    plain, prepared = CellScene(SMOKE.simulated, SMOKE.radar, SEED, 2), CellScene(SMOKE.simulated, SMOKE.radar, SEED, 2)
    prepared.prepare(5, [(3, NO_RANGE), (9, NO_RANGE)])
    assert prepared.observe(6, 0.0, BEAM, LOOKS) == plain.observe(6, 0.0, BEAM, LOOKS)


def test_what_was_prepared_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the cells looked at only those that were not guessed are drawn when the waveform is there."""
    scene, drawn = CellScene(SMOKE.simulated, SMOKE.radar, SEED, 2), []

    def recorded(seed: int, purpose: Purpose, index: int, k: int) -> np.random.Generator:
        drawn.append((purpose, index))
        return generator(seed, purpose, index, k)

    scene.prepare(5, [(3, NO_RANGE), (4, NO_RANGE)])
    for module in ("scene", "targets"):
        monkeypatch.setattr(f"cogradar.shared.world.{module}.generator", recorded)
    scene.move()
    scene.observe(5, 0.0, BEAM, LOOKS)
    assert (Purpose.DISTURBANCE, 9) in drawn
    assert (Purpose.DISTURBANCE, 3) not in drawn
    assert not [purpose for purpose, _ in drawn if purpose is Purpose.MOTION]


def test_an_echo_raises_the_cell_of_its_target_alone() -> None:
    scene = CellScene(SMOKE.simulated, SMOKE.radar, SEED, 0)
    factor = np.empty((SMOKE.radar.array.n_tx, 0), dtype=np.complex128)
    cells = scene.observe(0, SMOKE.radar.array.power, factor, ALL)
    law = SMOKE.simulated.disturbance.model, SMOKE.radar.array.n_tx * SMOKE.radar.array.n_rx
    assert len(cells) == SMOKE.radar.array.n_bin
    occupied = set(scene.target_bins.tolist())
    silent = SMOKE.simulated.model_copy(update={"echo": WorldEchoSection.model_construct(amplitude_db=-300.0)})
    alone = CellScene(silent, SMOKE.radar, SEED, 0)
    for one, noise in zip(cells, alone.observe(0, SMOKE.radar.array.power, factor, ALL), strict=True):
        assert (abs(one.cell.alpha_hat - noise.cell.alpha_hat) > 1e-9) == (one.look.bin in occupied)
    assert draw(*law, generator(SEED, Purpose.DISTURBANCE, 0, 0)).size == law[1]


def test_an_echo_is_alpha_times_the_signature() -> None:
    rng = np.random.default_rng(1)
    y, u, a_rx = (rng.standard_normal(2 * n).view(np.complex128) for n in (15, 3, 5))
    expected = y + (0.3 - 0.7j) * np.kron(u, a_rx)
    add_echo(y, 0.3 - 0.7j, u, a_rx)
    np.testing.assert_allclose(y, expected, rtol=1e-14)


def test_targets_in_one_bin_add_up() -> None:
    """Two in one bin: alpha_hat less that of the disturbance alone is the sum of both echoes."""
    world, radar = SMOKE.simulated, SMOKE.radar
    crowded = world.model_copy(update={"targets": [world.targets[0]] * 2})
    factor, at_1_km = np.empty((radar.array.n_tx, 0), dtype=np.complex128), amplitude_at_1_km(world.echo.amplitude_db)
    scene = CellScene(crowded, radar, SEED, 0)
    looks = looks_at(int(scene.target_bins[0]))
    silent = crowded.model_copy(update={"echo": WorldEchoSection.model_construct(amplitude_db=-300.0)})
    (cell,), (noise,) = (s.observe(4, 1.0, factor, looks) for s in (scene, CellScene(silent, radar, SEED, 0)))
    expected = echo_amplitudes(scene.states, at_1_km, 2 * ["constant"], SEED, 4).sum()
    assert cell.cell.alpha_hat - noise.cell.alpha_hat == pytest.approx(expected, rel=1e-9)
