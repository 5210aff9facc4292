"""Antennas with errors, which the radar does not know: what echoes and jammers are, against loops."""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.scenario.document import ScenarioError
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import ArraySection
from cogradar.shared.scenario.world_config import WorldArraySection, WorldEchoSection
from cogradar.shared.signal.array import angle_bin, spatial_frequency, steering_vector
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.radar_equation import amplitude_at_1_km
from cogradar.shared.signal.waveform import Elements, beam_factor, root
from cogradar.shared.world.antennas import elements
from cogradar.shared.world.array_scene import ArrayScene
from cogradar.shared.world.targets import echo_amplitudes

Complexes = NDArray[np.complex128]

SEED, K, N = 3, 4, 16
BIG = ArraySection(n_tx=400, n_rx=300, n_bin=16, power=1.0)
NOTHING = np.empty((N, 0), dtype=np.complex128)
ERRORS = ("world.signal=array", "world.array.gain_sigma_db=2.0", "world.array.phase_sigma_deg=25.0")


def scene_of(*settings: str, amplitude_db: float = 70.0) -> ArrayScene:
    scenario = load("smoke", ["world.signal=array", *settings])
    echo, first = WorldEchoSection.model_construct(amplitude_db=amplitude_db), scenario.simulated.targets[:1]
    world = scenario.simulated.model_copy(update={"echo": echo, "targets": first})
    return ArrayScene(world, scenario.radar, SEED, 0)


def drawn(gain_sigma_db: float, phase_sigma_deg: float, seed: int = SEED) -> Elements:
    section = WorldArraySection(gain_sigma_db=gain_sigma_db, phase_sigma_deg=phase_sigma_deg)
    found = elements(section, BIG, seed)
    assert found is not None
    return found


def echo(isotropic: float, factor: Complexes, *settings: str) -> complex:
    """What an echo adds to alpha_hat of a look at its target."""
    nu = float(spatial_frequency(scene_of().states)[0])
    look = Look(nu, int(angle_bin(nu, N)), (), np.inf)
    (one,), (none,) = (
        scene_of(*settings, amplitude_db=db).observe(K, isotropic, factor, [look]) for db in (70.0, -300.0)
    )
    return one.cell.alpha_hat - none.cell.alpha_hat


def test_gains_and_phases_have_their_standard_deviations_and_are_drawn_once() -> None:
    found = drawn(1.5, 10.0)
    for gains in found:
        n = gains.size
        assert np.std(20.0 * np.log10(np.abs(gains))) == pytest.approx(1.5, rel=5.0 / np.sqrt(2 * n))
        assert np.degrees(np.std(np.angle(gains))) == pytest.approx(10.0, rel=5.0 / np.sqrt(2 * n))
    assert np.array_equal(found.sent, drawn(1.5, 10.0).sent)
    assert not np.array_equal(found.sent, drawn(1.5, 10.0, 4).sent)
    assert not np.array_equal(found.sent[:300], found.received)


def test_an_array_without_errors_is_what_the_radar_assumes() -> None:
    assert elements(WorldArraySection(pattern_exponent=1.0), BIG, SEED) is None


@pytest.mark.parametrize("is_beam", [False, True])
def test_an_echo_is_sent_and_received_by_the_antennas_as_they_are(is_beam: bool) -> None:
    scene = scene_of(*ERRORS)
    nu = float(spatial_frequency(scene.states)[0])
    waveform = (0.2, beam_factor(np.array([nu + 0.01]), np.array([0.8]), N)) if is_beam else (1.0, NOTHING)
    (alpha,) = echo_amplitudes(scene.states, amplitude_at_1_km(70.0), ["constant"], SEED, K)
    section = WorldArraySection(gain_sigma_db=2.0, phase_sigma_deg=25.0)
    e, w, a = elements(section, scene._array, SEED), root(*waveform), steering_vector(nu, N)
    assert e is not None
    v = np.kron(w.T @ a, a)
    y = alpha * np.array([np.sum(w[:, i] * e.sent * a) * e.received[r] * a[r] for i in range(N) for r in range(N)])
    assert echo(*waveform, *ERRORS) == pytest.approx(complex(np.vdot(v, y) / np.vdot(v, v)), rel=1e-9)


def test_dead_antennas_send_and_receive_nothing() -> None:
    dead = echo(1.0, NOTHING, "world.array.dead_tx=[1, 16]", "world.array.dead_rx=[7]")
    assert dead / echo(1.0, NOTHING) == pytest.approx(14 / 16 * 15 / 16, rel=1e-9)


def test_jammers_are_received_by_the_antennas_as_they_are() -> None:
    jammed = ("world.jammers=[{bearing_deg = 0.0, jnr_db = 60.0}]", "world.array.dead_rx=[1, 2, 3, 4]")
    look = Look(0.0, 8, (), np.inf)
    (whole,), (dead,) = (scene_of(*settings).observe(K, 1.0, NOTHING, [look]) for settings in (jammed[:1], jammed))
    assert dead.cell.alpha_hat / whole.cell.alpha_hat == pytest.approx(12 / 16, abs=0.01)


def test_an_antenna_that_there_is_not_is_refused() -> None:
    with pytest.raises(ScenarioError) as refusal:
        load("smoke", ["world.signal=array", "world.array.dead_rx=[3, 17]"])
    assert "world.array.dead_rx=[3, 17]: must be antennas 1 .. 16, not 17" in str(refusal.value)


def test_measured_errors_come_from_a_file_and_drawn_ones_on_top(tmp_path: Path) -> None:
    """Echoes of an array with these gains: v^H (W^T (e_T a_T) kron e_R a_R) / ||v||^2 of the echo's amplitude."""
    rng = np.random.default_rng(2)
    errors = np.round(np.stack((rng.normal(0.0, 2.0, (2, N)), rng.normal(0.0, 40.0, (2, N))), axis=-1), 6)
    for name, rows in zip(("tx", "rx"), errors, strict=True):
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="gain_db,phase_deg", comments="", fmt="%.6f")
    settings = [f"world.array.{name}_errors={tmp_path}/{name}.csv" for name in ("tx", "rx")]
    e_tx, e_rx = 10.0 ** (errors[..., 0] / 20.0) * np.exp(1j * np.radians(errors[..., 1]))
    scene = scene_of(*settings)
    nu = float(spatial_frequency(scene.states)[0])
    (alpha,) = echo_amplitudes(scene.states, amplitude_at_1_km(70.0), ["constant"], SEED, K)
    a = steering_vector(nu, N)
    for isotropic, factor in ((1.0, NOTHING), (0.3, beam_factor(np.array([nu + 0.01]), np.array([0.7]), N))):
        w = root(isotropic, factor)
        v = np.kron(w.T @ a, a)
        expected = alpha * np.vdot(v, np.kron(w.T @ (e_tx * a), e_rx * a)) / np.vdot(v, v)
        assert echo(isotropic, factor, *settings) == pytest.approx(expected, rel=1e-6)
    assert echo(1.0, NOTHING, *settings, *ERRORS[1:]) != pytest.approx(echo(1.0, NOTHING, *settings), rel=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gain,phase\n0,0", "begins with 'gain,phase', must have the header gain_db,phase_deg"),
        ("gain_db,phase_deg\n0,x", "line 2, '0,x': must be 2 numbers, gain_db,phase_deg"),
        ("gain_db,phase_deg\n0,inf", "line 2, '0,inf': must be 2 numbers, gain_db,phase_deg"),
        ("gain_db,phase_deg\n0,0\n0,0", "has 2 rows, must have one of each antenna, 16"),
        ("gain_db,phase_deg\n" + 600 * "0,0\n", "line 514: must have at most 512 rows"),
        ("", "is empty, must have the header"),
        (None, "none.csv: no such file"),
    ],
)
def test_what_is_wrong_with_a_file_of_errors_is_said(text: str | None, said: str, tmp_path: Path) -> None:
    file = tmp_path / ("none.csv" if text is None else "e.csv")
    if text is not None:
        file.write_text(text)
    with pytest.raises(ScenarioError, match=re.escape(said)) as raised:
        scene_of(f"world.array.rx_errors={file}")
    assert "world.array.rx_errors" in str(raised.value)
