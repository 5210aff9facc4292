"""Waveforms against the full matrices they stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cogradar.shared.signal.array import bin_centres, steering_vector
from cogradar.shared.signal.waveform import (
    antenna_powers,
    beam_factor,
    beampattern,
    covariance,
    peak_to_average_db,
    root,
    transmit_signatures,
)

Complexes = NDArray[np.complex128]
NUS = bin_centres(100)
NOTHING = np.empty((100, 0), dtype=np.complex128)


@st.composite
def waveforms(draw: st.DrawFn) -> tuple[float, Complexes]:
    """Isotropic power and a factor, from none to more columns than antennas, some of them twice."""
    n_tx, r = draw(st.integers(1, 9)), draw(st.integers(0, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    factor = rng.standard_normal((n_tx, 2 * r)).view(np.complex128)
    if r > 1 and draw(st.booleans()):
        factor[:, 1] = factor[:, 0]
    return draw(st.sampled_from([0.0, 1e-6, 1.0, 50.0])), factor


def full_root(R: Complexes) -> Complexes:
    """Square root through the eigendecomposition of R."""
    values, vectors = np.linalg.eigh(R)
    W: Complexes = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ vectors.conj().T
    return W


@given(waveform=waveforms())
def test_covariance_has_the_power_of_its_parts(waveform: tuple[float, Complexes]) -> None:
    isotropic, factor = waveform
    R = covariance(isotropic, factor)
    np.testing.assert_allclose(R, R.conj().T, atol=1e-12)
    assert np.trace(R) == pytest.approx(isotropic + np.sum(np.abs(factor) ** 2))


@given(waveform=waveforms())
def test_root_is_the_hermitian_square_root(waveform: tuple[float, Complexes]) -> None:
    R, W = covariance(*waveform), root(*waveform)
    np.testing.assert_allclose(W, W.conj().T, atol=1e-10)
    np.testing.assert_allclose(W @ W, R, atol=1e-10)
    assert np.linalg.eigvalsh(W)[0] >= -1e-10
    np.testing.assert_allclose(
        W, full_root(R), atol=1e-6
    )  # the root of a rounding error 1e-14 in a zero eigenvalue is 1e-7


@given(waveform=waveforms(), nus=st.lists(st.floats(-0.5, 0.5), max_size=4))
def test_signatures_and_beampattern_equal_the_matrix_forms(waveform: tuple[float, Complexes], nus: list[float]) -> None:
    isotropic, factor = waveform
    n_tx = factor.shape[0]
    signatures = transmit_signatures(isotropic, factor, np.array(nus))
    power = beampattern(isotropic, factor, np.array(nus))
    assert (signatures.shape, power.shape) == ((len(nus), n_tx), (len(nus),))
    R, W = covariance(isotropic, factor), root(isotropic, factor)
    for nu, u, p in zip(nus, signatures, power, strict=True):
        a = steering_vector(nu, n_tx)
        np.testing.assert_allclose(u, W.T @ a, atol=1e-9)
        assert p == pytest.approx((a @ R @ a.conj()).real, abs=1e-9)
        assert np.sum(np.abs(u) ** 2) == pytest.approx(p, abs=1e-9)  # ||v||^2 / N_R


def test_orthogonal_waveform_sends_the_same_everywhere() -> None:
    np.testing.assert_allclose(beampattern(1.0, NOTHING, NUS), 1.0, rtol=1e-12)  # ||v||^2 = N_R = 100
    np.testing.assert_allclose(root(1.0, NOTHING), 0.1 * np.eye(100), atol=1e-15)  # sqrt(P / n_tx) I


def test_one_beam_reaches_the_full_gain_of_the_array() -> None:
    factor = beam_factor(NUS[37:38], [1.0], 100)
    power = beampattern(0.0, factor, NUS)
    assert power[37] == pytest.approx(100.0)  # P n_tx, so ||v||^2 = 10^4
    # sum over n of |a_k^T a_37^*|^2 / n_tx next door is 1 / 100: steering vectors 1/99 apart differ by one term of 100
    assert power[38] == pytest.approx(0.01)


@given(bins=st.lists(st.integers(0, 99), min_size=1, max_size=10), power=st.floats(0.1, 100.0))
def test_uniform_factor_gives_every_beam_the_same_power(bins: list[int], power: float) -> None:
    factor = beam_factor(NUS[bins], np.full(len(bins), power / len(bins)), 100)
    assert factor.shape == (100, len(bins))
    np.testing.assert_allclose(np.sum(np.abs(factor) ** 2, axis=0), power / len(bins), rtol=1e-12)
    # Each bin gets its own beam's whole gain, and what leaks from the others comes on top.
    assert np.all(beampattern(0.0, factor, NUS[bins]) >= power * 100 / len(bins) * (1 - 1e-12))


def test_two_tracks_on_one_bin_share_a_beam() -> None:
    twice = beam_factor(NUS[[10, 10]], [0.5, 0.5], 100)
    once = beam_factor(NUS[[10]], [1.0], 100)
    np.testing.assert_allclose(covariance(0.0, twice), covariance(0.0, once), atol=1e-14)
    np.testing.assert_allclose(
        transmit_signatures(0.0, twice, NUS[9:12]), transmit_signatures(0.0, once, NUS[9:12]), atol=1e-12
    )


@given(waveform=waveforms())
def test_powers_of_antennas_are_the_diagonal_of_the_covariance(waveform: tuple[float, Complexes]) -> None:
    isotropic, factor = waveform
    np.testing.assert_allclose(antenna_powers(isotropic, factor), np.diag(covariance(isotropic, factor)).real)
    assert (peak_to_average_db(isotropic, factor) >= 0.0).all()


@pytest.mark.parametrize("n_tx", [16, 21])
def test_one_direction_has_constant_modulus_and_two_beat(n_tx: int) -> None:
    nothing = np.empty((n_tx, 0), dtype=np.complex128)
    np.testing.assert_allclose(peak_to_average_db(2.0, nothing), 0.0, atol=1e-9)
    orthogonal = np.arange(2) * 3.0 / n_tx
    one, two = (beam_factor(orthogonal[:n], np.ones(n), n_tx) for n in (1, 2))
    np.testing.assert_allclose(peak_to_average_db(0.0, one), 0.0, atol=1e-9)
    assert 2.5 < peak_to_average_db(0.0, two).max() < 3.02  # two tones: 3 dB
    dead = one.copy()
    dead[3] = 0.0
    assert peak_to_average_db(0.0, dead)[3] == 0.0
