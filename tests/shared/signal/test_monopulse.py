"""Directions within the main lobe: closed forms against sums over the array, measured directions against draws."""

import numpy as np
import pytest
from scipy.linalg import toeplitz

from cogradar.shared.signal import monopulse
from cogradar.shared.signal.array import steering_vector
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.receiver import n_lag, wald_test
from cogradar.shared.signal.waveform import Signatures, beam_factor, transmit_signatures
from cogradar.shared.world.disturbance import draw, power_spectrum
from cogradar.shared.world.scene import add_echo
from tests.oracles import monopulse as plain

N_TX, N_RX = 16, 64
STEERED = Processing(is_steered=True, monopulse=True)


def _response(d: float, n: int) -> complex:
    """(1/N) sum_i exp(j 2 pi d (i - (N-1)/2))."""
    return complex(np.mean(np.exp(2j * np.pi * d * (np.arange(n) - 0.5 * (n - 1)))))


@pytest.mark.parametrize("n", [2, 7, 100])
def test_what_is_lost_off_the_axis_is_the_sum_over_the_array(n: int) -> None:
    d = np.linspace(-0.99 / n, 0.99 / n, 15)
    np.testing.assert_allclose(monopulse.off_axis_loss(d, n), [abs(_response(x, n)) for x in d], atol=1e-13)
    assert monopulse.off_axis_loss(0.0, n) == 1.0


@pytest.mark.parametrize("isotropic", [0.0, 1.0])
def test_an_echo_off_the_axis_comes_with_both_losses(isotropic: float) -> None:
    """alpha_hat of v(nu) in the cell at nu_c is alpha D_T D_R, for a beam and for the orthogonal waveform."""
    nu, d = 0.13, 0.4 / N_RX
    factor = beam_factor([nu], [1.0], N_TX) if isotropic == 0.0 else np.empty((N_TX, 0), np.complex128)
    u, off = transmit_signatures(isotropic, factor, np.array([nu, nu + d]))
    y = np.zeros(N_TX * N_RX, dtype=np.complex128)
    add_echo(y, 0.7 + 0j, off, steering_vector(nu + d, N_RX))
    losses = monopulse.off_axis_loss(d, N_TX) * monopulse.off_axis_loss(d, N_RX)
    assert abs(wald_test(y, u, steering_vector(nu, N_RX)).alpha_hat) == pytest.approx(0.7 * losses, rel=1e-12)


@pytest.mark.parametrize("n", [2, 7, 100])
def test_discriminator_and_slope_are_derivatives(n: int) -> None:
    for d in np.array([-0.95, -0.5, -1.1e-4, -0.9e-4, -1e-9, 0.0, 1e-5, 2e-4, 0.3, 0.9]) / n:
        step = 1e-4 / n
        assert monopulse.discriminator(d, n) == pytest.approx(
            (_response(d + step, n) - _response(d - step, n)).real / (2 * step * _response(d, n).real), abs=2e-6 * n
        )
        of_slope = monopulse.discriminator(d + step, n) - monopulse.discriminator(d - step, n)
        assert monopulse.slope(d, n) == pytest.approx(of_slope / (2 * step), rel=1e-4)


@pytest.mark.parametrize("n", [2, 7, 100])
def test_the_inverse_finds_the_direction_again(n: int) -> None:
    for d in np.array([-0.99, -0.5, -1e-3, 0.0, 1e-6, 0.2, 0.999]) / n:
        assert monopulse.off_axis(monopulse.discriminator(d, n), n) == pytest.approx(d, abs=1e-11 / n)
    assert abs(monopulse.off_axis(1e12, n)) <= 1.0 / n


def test_without_noise_the_direction_is_measured_exactly() -> None:
    rng = np.random.default_rng(1)
    for nu, d in zip(rng.uniform(-0.4, 0.4, 20), rng.uniform(-0.95, 0.95, 20) / N_RX, strict=True):
        u, off = transmit_signatures(0.0, beam_factor([nu, nu + 0.05], [0.7, 0.3], N_TX), np.array([nu, nu + d]))
        y = np.kron((0.3 - 0.4j) * off, steering_vector(nu + d, N_RX))
        rho = plain.ratio(y, u, steering_vector(nu, N_RX))
        assert monopulse.direction(nu, rho, 0.0, N_RX)[0] == pytest.approx(nu + d, abs=1e-10)


@pytest.mark.parametrize("isotropic", [0.0, 0.3])
def test_the_kernel_measures_what_products_of_whole_signatures_do(isotropic: float) -> None:
    rng = np.random.default_rng(3)
    signatures = Signatures(isotropic, beam_factor([-0.2, 0.1, 0.14], [0.3, 0.3, 0.1], N_TX), N_RX)
    for nu, d in zip([0.1, -0.2, 0.11, 0.498], [0.4, -0.7, 0.0, 0.9], strict=True):
        y = draw("ar6-t", N_TX * N_RX, rng)
        add_echo(y, 4.0 - 1.0j, *signatures.at(nu + d / N_RX))
        own = signatures.at(nu)
        found = monopulse.off_axis_echo(y, own, signatures.root, nu, n_lag(y.size))
        assert found == pytest.approx(plain.measured(y, signatures, nu), rel=1e-9)


@pytest.mark.parametrize(("nu", "d", "at"), [(0.499, 0.003, -0.498), (-0.5, -0.002, 0.498), (0.499, -0.003, 0.496)])
def test_a_direction_beyond_an_end_is_at_the_other(nu: float, d: float, at: float) -> None:
    measured = monopulse.direction(nu, float(monopulse.discriminator(d, N_RX)), 1.0, N_RX)[0]
    assert measured == pytest.approx(at, abs=1e-9)
    assert measured == pytest.approx(np.angle(np.exp(2j * np.pi * (nu + d))) / (2.0 * np.pi), abs=1e-9)


def test_on_the_axis_sigma_is_what_everybody_quotes() -> None:
    rho_sigma = monopulse.flat_ratio_sigma(0.0, 5.0, 100)
    assert monopulse.direction(0.1, 0.0, rho_sigma, 100)[1] == pytest.approx(0.39 / (100 * 5.0), rel=2e-3)


@pytest.mark.parametrize(("model", "offset"), [("white", 0.0), ("white", 0.6), ("ar6-t", 0.0), ("ar6-t", -0.5)])
def test_errors_have_the_standard_deviation_that_is_reported(model: str, offset: float) -> None:
    """Over many draws of a strong echo: the errors in units of the sigma reported with each of them."""
    rng, look, n = np.random.default_rng(2), Look(-0.21, 0, (), 1e-9), 400
    nu, signatures = look.nu + offset / N_RX, Signatures(1.0, np.empty((N_TX, 0), np.complex128), N_RX)
    rows = []
    for _ in range(n):
        y = draw(model, N_TX * N_RX, rng)
        add_echo(y, 5.0 * np.exp(2j * np.pi * rng.random()), *signatures.at(nu))
        rows.append(DataSet(y, signatures, STEERED).measure(look, 0.0))
    errors = np.array([(row.nu_hat - nu) / row.nu_sigma for row in rows])
    assert errors.mean() == pytest.approx(0.0, abs=4.0 / np.sqrt(n))
    assert errors.std() == pytest.approx(1.0, abs=0.14)  # four of its own standard deviations
    # The echo itself, which the cell matches in part, is not taken for noise.
    level = np.sqrt(power_spectrum(model, look.nu) / rows[0].cell.signature_power)
    assert np.mean([row.cell.sigma_hat for row in rows]) == pytest.approx(level, rel=0.1)


@pytest.mark.parametrize("nu", [-0.1, 0.26, 0.4])
def test_the_error_is_that_of_the_spectrum_beside_the_cell(nu: float) -> None:
    """Against e^H C e of the disturbance's own covariance; 8 % more than of a flat spectrum, as much, and 8 % less."""
    n, rng = 32, np.random.default_rng(4)
    look, signatures = Look(nu, 0, (), 1e-9), Signatures(0.0, beam_factor([nu], [1.0], n), n)
    u, a_rx = signatures.at(nu)
    grid = np.arange(4096) / 4096
    lags = np.fft.ifft(power_spectrum("ar6-t", grid))[: n * n]  # covariance at each lag: the spectrum's coefficients
    rows = []
    for _ in range(150):
        y = draw("ar6-t", n * n, rng)
        add_echo(y, 2.0 + 0j, u, a_rx)
        rows.append(DataSet(y, signatures, STEERED).measure(look, 0.0))
    e = np.kron(u, 2j * np.pi * (np.arange(n) - 0.5 * (n - 1)) * a_rx)
    power = float(np.vdot(e, toeplitz(lags, lags.conj()) @ e).real)
    exact = np.sqrt(0.5 * power) / (2.0 * np.vdot(u, u).real * n) / monopulse.kappa_sq(n)
    assert np.median([row.nu_sigma for row in rows]) == pytest.approx(exact, rel=0.03)
