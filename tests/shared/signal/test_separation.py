"""Echoes told apart: against projections of whole signatures, and over draws beside strong targets."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from cogradar.shared.scenario.files import load
from cogradar.shared.signal.detector import separation
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.detector.separation import (
    Echoes,
    as_chi_square,
    beside,
    find_echoes,
    fit,
    no_echoes,
    without,
)
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.receiver import clustered, n_lag, threshold, wald_test
from cogradar.shared.signal.waveform import Signatures, beam_factor
from cogradar.shared.world.disturbance import draw
from cogradar.shared.world.scene import add_echo

N_TX, N_RX = 20, 24
ISOTROPIC = Signatures(float(N_TX), np.empty((N_TX, 0), np.complex128), N_RX)
BEAMS = Signatures(2.0, beam_factor([-0.3, -0.1, 0.0, 0.2], [5.0, 5.0, 4.0, 4.0], N_TX), N_RX)
JOINT = Processing(is_steered=True, monopulse=True, separates=True)


def _data(
    signatures: Signatures, nus: list[float], amplitudes: list[float], rng: np.random.Generator, model: str = "ar6-t"
) -> NDArray[np.complex128]:
    y = draw(model, N_TX * N_RX, rng)
    for nu, amplitude in zip(nus, amplitudes, strict=True):
        add_echo(y, amplitude * np.exp(2j * np.pi * rng.random()), *signatures.at(nu))
    return y


def _echoes(signatures: Signatures, nus: list[float]) -> Echoes:
    u, a = zip(*(signatures.at(nu) for nu in nus), strict=True)
    return Echoes(np.array(nus), np.array(u), np.array(a))


def _limits(n: int, p_fa: float) -> tuple[float, float]:
    """Binomial ones of false alarms in n looks, with a fifth for what small arrays add."""
    return float(binom.ppf(1e-4, n, p_fa / 1.2)), float(binom.ppf(1.0 - 1e-4, n, p_fa * 1.2))


@pytest.mark.parametrize("signatures", [ISOTROPIC, BEAMS])
def test_a_fit_is_the_projection_on_whole_signatures(signatures: Signatures) -> None:
    rng = np.random.default_rng(1)
    y = _data(signatures, [-0.3, 0.05], [3.0, 2.0], rng)
    own, others = signatures.at(-0.1), [-0.3, 0.05, 0.2]
    v = np.array([np.kron(*signatures.at(nu)) for nu in (-0.1, *others)]).T
    inverse = np.linalg.inv(v.conj().T @ v)
    alphas, e = inverse @ v.conj().T @ y, v @ inverse[:, 0]
    x = (y - v @ alphas) * e.conj()
    lags = n_lag(y.size)
    by_lags = np.sum(np.abs(x) ** 2) + 2 * sum(np.sum(x[m:] * x[:-m].conj()).real for m in range(1, lags + 1))
    weights = np.sum(np.abs(e.reshape(N_TX, N_RX)) ** 2, axis=1)
    k = weights.sum() ** 2 / (weights**2).sum()
    by_rows = k / (k - 1) * np.sum(np.abs(x.reshape(N_TX, N_RX).sum(axis=1)) ** 2)
    power = 1.0 / inverse[0, 0].real
    for n, expected, dof in ((lags, by_lags, 0.0), (0, by_rows, k - 1.0)):
        found = fit(y, own, _echoes(signatures, others), n)
        assert found == pytest.approx((alphas[0], expected, power, dof), rel=1e-8)
    np.testing.assert_allclose(
        without(y, _echoes(signatures, [-0.1, *others]), np.array([False, True, True, True])),
        y - v[:, 1:] @ alphas[1:],
        atol=1e-9,
    )


@pytest.mark.parametrize("signatures", [ISOTROPIC, BEAMS])
def test_without_other_echoes_it_is_the_wald_test(signatures: Signatures) -> None:
    y = _data(signatures, [0.2], [1.0], np.random.default_rng(2))
    own = signatures.at(0.2)
    cell, found = wald_test(y, *own), fit(y, own, no_echoes(N_TX, N_RX), n_lag(y.size))
    assert found.alpha_hat == pytest.approx(cell.alpha_hat, rel=1e-10)
    assert np.sqrt(found.b) == pytest.approx(cell.sigma_hat, rel=1e-9)
    assert found.signature_power == pytest.approx(cell.signature_power, rel=1e-10)
    rows = fit(y, own, no_echoes(N_TX, N_RX), 0)
    at_once = DataSet(y, signatures, Processing(is_steered=True, monopulse=True, by_rows=True)).tests(np.array([0.2]))
    statistic = as_chi_square(np.array([2.0 * abs(rows.alpha_hat) ** 2 / rows.b]), np.array([rows.dof]))
    assert at_once.statistic == pytest.approx(statistic, rel=1e-9)
    assert at_once.sigma_hat == pytest.approx(np.sqrt(rows.b), rel=1e-9)
    power, b = clustered(y, *own)
    assert (power, b / power**2) == pytest.approx((cell.signature_power, rows.b), rel=1e-9)


def test_a_strong_echo_keeps_its_direction_beside_another_in_a_single_beam() -> None:
    """The fit of the others must not take a part of the look's own echo."""
    rng, look = np.random.default_rng(8), Look(0.1, 0, (), threshold(1e-4))
    beam = Signatures(0.0, beam_factor([look.nu], [float(N_TX)], N_TX), N_RX)
    nu, errors = look.nu + 0.1 / N_RX, list[float]()
    for _ in range(40):
        y = _data(beam, [nu, look.nu + 1.2 / N_RX], [3.0, 1.5], rng, "white")
        errors.append((DataSet(y, beam, JOINT).measure(look, 0.0).nu_hat - nu) * N_RX)
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


@pytest.mark.parametrize(("n_tx", "n_rx"), [(2, 24), (4, 24), (8, 32)])
def test_in_noise_alone_no_echo_is_found_however_few_channels_there_are(n_tx: int, n_rx: int) -> None:
    rng, signatures = np.random.default_rng(9), Signatures(float(n_tx), np.empty((n_tx, 0), np.complex128), n_rx)
    found = [find_echoes(draw("white", n_tx * n_rx, rng), signatures).nus.size for _ in range(40)]
    assert sum(found) <= 1


def test_the_keys_of_a_scenario_choose_the_processing() -> None:
    chosen = load("paper-best", ["radar.receiver.separation=joint"]).radar.receiver
    assert Processing.of(chosen) == Processing(is_steered=True, monopulse=True, by_rows=False, separates=True)
    rows = load("paper", ["radar.receiver.noise=rows"]).radar.receiver
    assert Processing.of(rows) == Processing(is_steered=False, monopulse=False, by_rows=True, separates=False)


@pytest.mark.parametrize(("signatures", "nus"), [(ISOTROPIC, [-0.41, -0.2, 0.07, 0.4]), (BEAMS, [-0.3, -0.1, 0.2])])
def test_strong_echoes_are_found_where_they_are(signatures: Signatures, nus: list[float]) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        y = _data(signatures, nus, [3.0, 1.0, 2.0, 1.5][: len(nus)], rng, "white")
        found = np.sort(find_echoes(y, signatures).nus)
        assert found.size == len(nus)
        assert np.abs(found - nus).max() < 0.15 / N_RX


def test_one_direction_beyond_end_fire_is_one_echo() -> None:
    y = _data(ISOTROPIC, [0.495], [4.0], np.random.default_rng(4))
    found = find_echoes(y, ISOTROPIC)
    assert found.nus.size == 1
    assert min(abs(found.nus[0] - 0.495), abs(found.nus[0] + 0.505)) < 0.15 / N_RX
    assert beside(found, -0.499).nus.size == 0  # around the end it is in that look's main lobe


@pytest.mark.parametrize("by_rows", [False, True])
def test_strong_targets_neither_hide_nor_make_detections(by_rows: bool) -> None:
    """Beside four targets of up to 20 dB a channel: as many false alarms as nominal, and none without separation."""
    rng, p_fa, processing = np.random.default_rng(5), 0.02, JOINT._replace(by_rows=by_rows)
    alone, n, n_false, n_plain, n_blind = processing._replace(separates=False), 0, 0, 0, 0
    looks = (np.arange(N_RX) + 0.5) / N_RX - 0.5
    for _ in range(250):
        targets = (np.arange(4) - 1.5 + 0.2 * rng.uniform(-1.0, 1.0, 4)) / 4.2
        y = _data(ISOTROPIC, targets.tolist(), (10.0 ** (rng.uniform(-5.0, 20.0, 4) / 20.0)).tolist(), rng, "white")
        off = np.abs(looks[:, np.newaxis] - targets)
        nus = looks[np.minimum(off, 1.0 - off).min(axis=1) > 1.05 / N_RX]
        joint, plain = (DataSet(y, ISOTROPIC, one).tests(nus).statistic for one in (processing, alone))
        n, n_false = n + nus.size, n_false + int((joint >= threshold(p_fa)).sum())
        n_plain, n_blind = n_plain + int((plain >= threshold(p_fa)).sum()), n_blind + int((plain == 0.0).sum())
    low, high = _limits(n, p_fa)
    assert low <= n_false <= high
    assert n_plain < low or n_plain > high or n_blind > 0.1 * n


def test_a_weak_target_is_seen_and_measured_beside_a_strong_one() -> None:
    rng, look = np.random.default_rng(6), Look(0.1, 0, (), threshold(1e-3))
    strong, errors = 0.1 + 2.3 / N_RX, list[float]()
    for _ in range(60):
        y = _data(ISOTROPIC, [strong, 0.105], [8.0, 0.35], rng, "white")
        joint = DataSet(y, ISOTROPIC, JOINT).measure(look, 0.0)
        assert joint.cell.statistic > look.limit
        errors.append((joint.nu_hat - 0.105) / joint.nu_sigma)
        plain = DataSet(y, ISOTROPIC, JOINT._replace(separates=False)).measure(look, 0.0)
        assert plain.cell.statistic < joint.cell.statistic
    assert abs(np.mean(errors)) < 0.6
    assert np.std(errors) < 1.6


def test_many_echoes_are_those_that_are_found_one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a third of the rounds."""
    n, rng = 64, np.random.default_rng(8)
    signatures, y = Signatures(float(n), np.empty((n, 0), np.complex128), n), draw("white", n * n, rng)
    nus = np.linspace(-0.48, 0.46, 26) + rng.uniform(-0.3, 0.3, 26) / n
    for nu, gain_db in zip(nus.tolist(), rng.uniform(-15.0, 15.0, 26).tolist(), strict=True):
        add_echo(y, 10.0 ** (gain_db / 20.0) * np.exp(2j * np.pi * rng.random()), *signatures.at(nu))
    rounds, relaxed = list[int](), separation._relaxed

    def counted(*given: Any) -> Any:
        rounds.append(given[2].size)
        return relaxed(*given)

    monkeypatch.setattr(separation, "_relaxed", counted)
    found = np.sort(find_echoes(y, signatures).nus)
    n_round = len(rounds)
    monkeypatch.setattr(separation, "_FOUND_FOR_EACH", n)
    expected = np.sort(find_echoes(y, signatures).nus)
    assert np.abs(found - nus).max() < 0.1 / n
    np.testing.assert_allclose(found, expected, atol=5e-3 / n)
    assert n_round < 0.45 * (len(rounds) - n_round)


def test_a_jammer_blinds_the_sum_over_lags_and_not_that_over_rows() -> None:
    """Noise of one direction is correlated over the whole receive array, and independent from channel to channel."""
    rng, nus = np.random.default_rng(7), (np.arange(N_RX) + 0.5) / N_RX - 0.5
    jammer = np.exp(2j * np.pi * 0.13 * np.arange(N_RX))
    n_false, n_blind, n_draw = 0, 0, 200
    for _ in range(n_draw):
        y = draw("white", N_TX * N_RX, rng)
        gains = (rng.standard_normal(N_TX) + 1j * rng.standard_normal(N_TX)) / np.sqrt(2.0)
        y += np.kron(10.0 * gains, jammer)
        rows, lags = (
            DataSet(y, ISOTROPIC, Processing(is_steered=True, monopulse=True, by_rows=by_rows)).tests(nus)
            for by_rows in (True, False)
        )
        assert (rows.sigma_hat > 0.0).all()
        n_blind += int((lags.sigma_hat == 0.0).sum())
        n_false += int((rows.statistic >= threshold(0.02)).sum())
    low, high = _limits(n_draw * N_RX, 0.02)
    assert low <= n_false <= high
    assert n_blind > 0.2 * n_draw * N_RX


@pytest.mark.parametrize("signatures", [ISOTROPIC, BEAMS])
@pytest.mark.parametrize("by_rows", [False, True])
def test_statistics_far_below_their_limits_are_nearly_exact_and_all_others_exact(
    signatures: Signatures, by_rows: bool
) -> None:
    rng, processing = np.random.default_rng(11), JOINT._replace(by_rows=by_rows)
    nus, limits = np.linspace(-0.45, 0.45, 40), np.full(40, threshold(1e-2))
    for _ in range(10):
        data = DataSet(_data(signatures, [-0.3, 0.2], [3.0, 2.0], rng), signatures, processing)
        exact, screened = data.tests(nus), data.tests(nus, limits)
        assert data.echoes.nus.size >= 1
        is_near = exact.statistic > 0.6 * limits
        for one, other in zip(exact, screened, strict=True):
            np.testing.assert_allclose(other[is_near], one[is_near], rtol=1e-9)
        np.testing.assert_allclose(screened.alpha_hat, exact.alpha_hat, atol=1e-8)
        np.testing.assert_allclose(screened.signature_power, exact.signature_power, rtol=1e-6)
        is_known = ~is_near & (exact.statistic > 0.05)
        np.testing.assert_allclose(screened.statistic[is_known], exact.statistic[is_known], rtol=0.3)
