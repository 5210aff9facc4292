"""Many directions tested from one data set are as each of them tested by itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cogradar.shared.signal.detector.data_set import Cells, wald_tests
from cogradar.shared.signal.receiver import Cell
from cogradar.shared.signal.waveform import Signatures, beam_factor
from tests.oracles.detection import literal_cell

Complexes = NDArray[np.complex128]


def data_set(n_tx: int, n_rx: int, seed: int, echo_db: float) -> tuple[Complexes, Complexes]:
    """Noise, and noise with an echo of an isotropic waveform."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(2 * n_tx * n_rx).view(np.complex128)
    u, a_rx = Signatures(1.0, np.empty((n_tx, 0), dtype=np.complex128), n_rx).at(rng.uniform(-0.5, 0.5))
    return noise, noise + 10.0 ** (echo_db / 20.0) * np.kron(u, a_rx)


def assert_same(cells: Cells, expected: list[Cell], y: Complexes) -> None:
    """B is a difference of sums of |y|^2 |v|^2, and may be 0 but for rounding: then the statistic is anything."""
    for i, cell in enumerate(expected):
        one, largest = cells.cell(i), cell.signature_power * float(np.vdot(y, y).real)
        assert one.signature_power == pytest.approx(cell.signature_power, rel=1e-12)
        assert one.alpha_hat == pytest.approx(cell.alpha_hat, rel=1e-9, abs=1e-12)
        b = [(c.sigma_hat * c.signature_power) ** 2 for c in (one, cell)]
        assert b[0] == pytest.approx(b[1], rel=1e-9, abs=1e-12 * largest)
        if b[1] > 1e-6 * largest:
            assert one.statistic == pytest.approx(cell.statistic, rel=1e-5)


@settings(max_examples=40, deadline=None)
@given(
    n_tx=st.integers(1, 9),
    n_rx=st.integers(1, 12),
    seed=st.integers(0, 1000),
    isotropic=st.sampled_from([0.0, 0.3, 2.0]),
    n_beam=st.sampled_from([0, 0, 2]),
    echo_db=st.sampled_from([-300.0, 0.0, 40.0]),
)
def test_each_direction_is_the_test_term_by_term(
    n_tx: int, n_rx: int, seed: int, isotropic: float, n_beam: int, echo_db: float
) -> None:
    _, y = data_set(n_tx, n_rx, seed, echo_db)
    nus = np.array([-0.5, -0.31, 0.0, 0.123, 0.5])
    beams = beam_factor(nus[1 : 1 + n_beam], np.ones(n_beam), n_tx)
    signatures = Signatures(isotropic, beams, n_rx)
    if isotropic == 0.0 and not n_beam:
        assert wald_tests(y, signatures, nus).cell(2) == Cell(0.0, 0j, 0.0, 0.0)
        return
    expected = [literal_cell(y, np.kron(*signatures.at(nu)).astype(np.complex128)) for nu in nus.tolist()]
    assert_same(wald_tests(y, signatures, nus), expected, y)


def test_no_direction_is_no_cell() -> None:
    _, y = data_set(4, 6, 1, 0.0)
    for beams in (np.empty((4, 0), dtype=np.complex128), beam_factor(np.array([0.1]), np.ones(1), 4)):
        assert wald_tests(y, Signatures(1.0, beams, 6), np.empty(0)).statistic.size == 0


def test_directions_at_both_ends_are_one() -> None:
    _, y = data_set(16, 16, 1, 10.0)
    cells = wald_tests(y, Signatures(1.0, np.empty((16, 0), dtype=np.complex128), 16), np.array([-0.5, 0.5]))
    assert cells.cell(0) == pytest.approx(cells.cell(1), rel=1e-9)
