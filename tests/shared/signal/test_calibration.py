"""Errors of an array and of its data are found in recordings of noise and of a target, whatever the sizes."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.front_end import Calibration, Signatures, calibrate
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.waveform import beam_factor
from cogradar.shared.world.disturbance import draw

Complexes = NDArray[np.complex128]
Change = Callable[[Complexes], Complexes]

SIZES = [(16, 16), (9, 14), (20, 6), (64, 64)]
BEARING = 20.0
K = 32


def radar_of(n_tx: int, n_rx: int, *settings: str) -> RadarConfig:
    return load("smoke", [f"radar.array.n_tx={n_tx}", f"radar.array.n_rx={n_rx}", *settings]).radar


def recording(
    size: tuple[int, int],
    bearing_deg: float | None = None,
    seed: int = 1,
    waveform: tuple[float, Complexes] | None = None,
    sent: Complexes | None = None,
    model: str = "ar6-t",
    amplitude: float = 12.0,
) -> Complexes:
    """K snapshots of noise, with or without a target; sent: gains of the transmit antennas."""
    n_tx, n_rx = size
    rng = np.random.default_rng(seed)
    y = np.array([draw(model, n_tx * n_rx, rng) for _ in range(K)]).reshape(K, n_tx, n_rx)
    if bearing_deg is not None:
        signatures = Signatures(*(waveform or (1.0, np.empty((n_tx, 0), np.complex128))), n_rx)
        u, a = signatures.at(0.5 * float(np.sin(np.radians(bearing_deg))))
        alphas = amplitude * np.exp(2j * np.pi * rng.random(K))
        y += np.einsum("k,i,r->kir", alphas, u if sent is None else u * sent, a)
    return y


def said(found: Calibration) -> str:
    return " ".join(f"{one.what} {one.cure}" for one in found.findings)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("model", ["ar6-t", "white"])
def test_what_is_as_assumed_is_not_suspicious(size: tuple[int, int], model: str) -> None:
    radar = radar_of(*size)
    alone = calibrate(recording(size, model=model), radar)
    assert alone.findings == []
    assert alone.transmit is alone.receive is None
    assert alone.noise.levels_db.shape == (radar.array.n_bin,)
    assert abs(alone.noise.power_db) < 0.3
    with_target = calibrate(recording(size, BEARING, model=model), radar, bearing_deg=BEARING)
    assert with_target.findings == []
    for side in (with_target.transmit, with_target.receive):
        assert side is not None
        assert np.degrees(np.arcsin(2.0 * side.nu)) == pytest.approx(BEARING, abs=0.7)
        assert np.abs(np.abs(side.gains) - 1.0).max() < 6.0 * side.sigma
    assert with_target.amplitude_db == pytest.approx(20.0 * np.log10(12.0), abs=0.3)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    ("change", "what", "cure"),
    [
        (np.conj, "wrong at both ends", "conjugate of Y"),
        (lambda y: y[:, :, ::-1], "wrong at the receive end alone", "Reverse the columns"),
        (lambda y: y[:, ::-1], "wrong at the transmit end alone", "Reverse the rows"),
        (lambda y: y[:, ::-1].conj(), "wrong at the receive end alone", "Reverse the columns"),
    ],
    ids=["conjugate", "receive reversed", "transmit reversed", "both"],
)
def test_the_sign_of_the_steering_vector_is_found_at_each_end(
    size: tuple[int, int], change: Change, what: str, cure: str
) -> None:
    found = calibrate(change(recording(size, BEARING)), radar_of(*size), bearing_deg=BEARING)
    (one,) = found.findings
    assert what in one.what
    assert cure in one.cure
    assert found.receive is not None
    assert np.degrees(np.arcsin(2.0 * found.receive.nu)) == pytest.approx(BEARING, abs=0.7)


@pytest.mark.parametrize("size", [(9, 14), (20, 6)])
def test_data_stored_with_the_receive_antenna_first_are_found(size: tuple[int, int]) -> None:
    stored = recording(size, BEARING).swapaxes(1, 2)
    (one,) = calibrate(stored.reshape(K, *size), radar_of(*size), bearing_deg=BEARING).findings
    assert f"Y.reshape({size[1]}, {size[0]}).T" in one.cure
    with pytest.raises(ValueError, match="exchange the last two axes"):
        calibrate(stored, radar_of(*size), bearing_deg=BEARING)


@pytest.mark.parametrize("n", [12, 32])
def test_a_transposed_square_is_found_with_beams_and_said_to_be_unknown_without(n: int) -> None:
    nu = 0.5 * float(np.sin(np.radians(BEARING)))
    sent = (0.1, beam_factor([nu + 0.4 / n, -0.3], [0.6, 0.3], n))
    y = recording((n, n), BEARING, waveform=sent)
    radar = radar_of(n, n)
    assert calibrate(y, radar, bearing_deg=BEARING, waveform=sent).findings == []
    assert "Y is transposed" in said(calibrate(y.swapaxes(1, 2), radar, bearing_deg=BEARING, waveform=sent))
    notes = calibrate(recording((n, n), BEARING).swapaxes(1, 2), radar, bearing_deg=BEARING).notes
    assert any("with beams" in note for note in notes)


@pytest.mark.parametrize("size", SIZES)
def test_a_dead_element_is_found(size: tuple[int, int]) -> None:
    radar, gains = radar_of(*size), np.ones(size[0], np.complex128)
    gains[4] = 0.0
    quiet = calibrate(recording(size, BEARING, sent=gains), radar, bearing_deg=BEARING)
    assert "transmit antennas 4 are dead: the echo" in said(quiet)
    y = recording(size)
    y[:, :, 2] = 0.0
    assert "receive channels 2 have infinitely less noise" in said(calibrate(y, radar))
    y[:, :, 2] = 0.1 * recording(size, seed=2)[:, :, 2]
    assert "receive channels 2 have up to" in said(calibrate(y, radar))


@pytest.mark.parametrize("size", SIZES)
def test_a_conjugated_receiver_and_two_that_are_exchanged_are_found(size: tuple[int, int]) -> None:
    radar = radar_of(*size)
    y = recording(size, BEARING)
    y[:, :, 3] = y[:, :, 3].conj()
    (one,) = calibrate(y, radar, bearing_deg=BEARING).findings
    assert "receive antennas 3 deliver conjugate data" in one.what
    y = recording(size, BEARING)
    y[:, [1, 4]] = y[:, [4, 1]]
    (one,) = calibrate(y, radar, bearing_deg=BEARING).findings
    assert "transmit antennas 1 and 4 are exchanged" in one.what


@pytest.mark.parametrize("size", SIZES)
def test_gain_and_phase_of_an_antenna_are_measured(size: tuple[int, int]) -> None:
    gains = np.ones(size[0], np.complex128)
    gains[2], gains[6] = 2.0, np.exp(1j)
    found = calibrate(recording(size, BEARING, sent=gains), radar_of(*size), bearing_deg=BEARING)
    assert "transmit antennas 2 have gains up to" in said(found)
    assert "transmit antennas 6 have phases up to" in said(found)
    assert len(found.findings) == 2
    assert found.transmit is not None
    assert abs(found.transmit.gains[2]) == pytest.approx(2.0, abs=0.3)
    assert np.angle(found.transmit.gains[6] / found.transmit.gains[0]) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("size", SIZES)
def test_the_scale_of_noise_and_echo_is_found(size: tuple[int, int]) -> None:
    radar = radar_of(*size)
    assert "+20.0 dB in an element of Y, must be 0 dB. Divide Y by 10" in said(calibrate(10.0 * recording(size), radar))
    range_km = 10.0 ** ((radar.echo.amplitude_db - 20.0 * np.log10(12.0)) / 40.0)
    y = recording(size, BEARING)
    assert calibrate(y, radar, bearing_deg=BEARING, range_km=range_km).findings == []
    wrong = said(calibrate(y, radar, bearing_deg=BEARING, range_km=2.0 * range_km))
    assert "Add 12." in wrong
    assert "radar.echo.amplitude_db" in wrong


@pytest.mark.parametrize("size", SIZES)
def test_an_echo_elsewhere_or_none_is_said(size: tuple[int, int]) -> None:
    radar = radar_of(*size)
    elsewhere = said(calibrate(recording(size, BEARING), radar, bearing_deg=-55.0))
    assert "The strongest echo is at" in elsewhere
    assert "given at -55.0 degrees" in elsewhere
    assert "No echo stands out" in said(calibrate(recording(size, BEARING, amplitude=1e-3), radar, bearing_deg=BEARING))


def test_near_boresight_the_sign_is_said_to_be_unknown() -> None:
    found = calibrate(recording((9, 14), 1.0), radar_of(9, 14), bearing_deg=1.0)
    assert found.findings == []
    assert any("too near to boresight" in note for note in found.notes)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda y: np.concatenate((y[:5], y[:1])), "snapshot 6 is snapshot 1"),
        (lambda y: np.clip(y.real, -1.5, 1.5) + 1j * np.clip(y.imag, -1.5, 1.5), "they are clipped"),
        (lambda y: np.round(y.real) + 1j * np.round(y.imag), "quantised in steps of 1"),
        (lambda y: y.real + 0j, "no imaginary part"),
        (lambda y: y.real + 0.3j * y.imag, "I and Q are unequal"),
        (lambda y: y + 2.0 * y[0], "is the same in all snapshots"),
    ],
    ids=["repeated", "clipped", "quantised", "real", "I and Q", "constant"],
)
@pytest.mark.parametrize("size", SIZES[:2])
def test_values_that_no_receiver_should_deliver_are_found(size: tuple[int, int], change: Change, what: str) -> None:
    assert what in said(calibrate(change(recording(size)), radar_of(*size)))


@pytest.mark.parametrize("size", [(16, 16), (32, 40)])
def test_blind_bins_and_interference_are_found(size: tuple[int, int]) -> None:
    """A source of noise from one direction: the published estimate is blind beside it, clusters are not."""
    rng, y = np.random.default_rng(3), recording(size)
    g = 30.0 * rng.standard_normal((K, 2 * size[0])).view(np.complex128)
    y += g[:, :, np.newaxis] * np.exp(2j * np.pi * 0.21 * np.arange(size[1]))
    by_lags = said(calibrate(y, radar_of(*size)))
    assert "are blind" in by_lags
    assert 'radar.receiver.noise = "rows"' in by_lags
    by_rows = said(calibrate(y, radar_of(*size, "radar.receiver.noise=rows")))
    assert "are blind" not in by_rows
    (degrees,) = re.findall(r"more noise than the others, most at ([-.\d]+) degrees", by_rows)
    assert float(degrees) == pytest.approx(np.degrees(np.arcsin(0.42)), abs=8.0)  # 16 bins


def test_a_target_in_what_should_be_noise_is_said() -> None:
    assert "% of the looks are detections, in noise 1 % would be" in said(
        calibrate(recording((16, 16), BEARING), radar_of(16, 16))
    )


@pytest.mark.parametrize(
    ("snapshots", "words"),
    [
        (np.zeros((3, 16, 16)), "all values are 0"),
        (np.full((3, 16, 16), np.nan), "768 of 768 values are NaN or infinite"),
        (np.zeros((0, 16, 16)), "of shape"),
        (np.ones((16, 15)), "of shape"),
        (np.full((1, 16, 16), "x"), "of type"),
    ],
)
def test_bad_data_are_refused_with_a_sentence(snapshots: Complexes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        calibrate(snapshots, radar_of(16, 16))
