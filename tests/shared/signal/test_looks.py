"""Gates in range cells, their thresholds, and what is reported of the cells of a look."""

import numpy as np
import pytest

from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.looks import (
    Look,
    Measured,
    directions_everywhere,
    range_cell_centre,
    range_cells,
    reported,
)
from cogradar.shared.signal.receiver import Cell, threshold, wald_test
from cogradar.shared.signal.waveform import Signatures


@pytest.mark.parametrize(
    ("gate", "cells"),
    [
        ((5.0, 5.0), range(10, 11)),
        ((5.1, 5.2), range(10, 11)),
        ((5.0, 9.0), range(10, 18)),
        ((4.9, 9.1), range(9, 19)),
        ((0.0, 0.2), range(1)),
    ],
)
def test_a_gate_is_all_cells_that_it_touches(gate: tuple[float, float], cells: range) -> None:
    assert range_cells(*gate, 0.5) == cells


def test_a_gate_from_edge_to_edge_has_no_further_cell() -> None:
    """Whatever a product of a number and a width is rounded to."""
    for width in (0.1, 0.3, 0.7):
        for first in range(1, 300):
            assert range_cells(first * width, (first + 8) * width, width) == range(first, first + 8)
            assert range_cell_centre(first, width) == pytest.approx(first * width + 0.5 * width)


@pytest.mark.parametrize("n", [1, 2, 64, 390])
def test_the_largest_of_n_is_over_the_threshold_as_often_as_one(n: int) -> None:
    for p_fa in (1e-9, 1e-4, 0.05):
        missed = -np.expm1(-0.5 * threshold(p_fa, n))  # of one cell
        assert -np.expm1(n * np.log(missed)) == pytest.approx(p_fa, rel=1e-6)
    assert threshold(1e-4) == -2.0 * np.log(1e-4)


LOOK = Look(0.1, 9, range(4), 10.0)


def _measured(look: Look, *statistics: float) -> list[Measured]:
    return [Measured(look, Cell(value, 1j, 1.0, 1.0), i, look.nu, 0.0) for i, value in enumerate(statistics)]


def test_the_largest_and_whatever_is_over_the_limit_is_reported_of_each_look() -> None:
    beside = LOOK._replace(nu=0.11)
    rows = [*_measured(LOOK, 3.0, 7.0, 5.0), *_measured(beside, 12.0, 7.0, 15.0, 10.0)]
    found = [(one.look.nu, one.cell.statistic) for one in reported(rows)]
    assert found == [(0.1, 7.0), (0.11, 15.0), (0.11, 12.0), (0.11, 10.0)]


def test_of_merged_looks_one_row_is_reported_of_each_bin() -> None:
    merged = LOOK._replace(is_merged=True)
    beside, next_one = merged._replace(nu=0.11), merged._replace(nu=0.15, bin=10)
    rows = [*_measured(merged, 12.0, 17.0), *_measured(beside, 15.0, 3.0), *_measured(next_one, 1.0, 2.0)]
    assert [(one.look.nu, one.cell.statistic) for one in reported(rows)] == [(0.1, 17.0), (0.15, 2.0)]


@pytest.mark.parametrize("n_bin", [16, 100])
def test_with_range_cells_no_target_is_more_than_a_quarter_of_a_bin_off(n_bin: int) -> None:
    assert np.array_equal(directions_everywhere(n_bin, 0.0), bin_centres(n_bin))
    nus = directions_everywhere(n_bin, 0.5)
    assert angle_bin(nus, n_bin).tolist() == [bin_ for bin_ in range(n_bin) for _ in range(2)]
    anywhere = np.linspace(-0.5, 0.5, 1001)
    assert np.abs(anywhere[:, None] - nus).min(axis=1).max() <= 0.2501 / (n_bin - 1)


def test_only_a_detection_measures_its_direction_and_only_with_monopulse() -> None:
    signatures = Signatures(1.0, np.empty((4, 0), np.complex128), 8)
    noise = np.random.default_rng(1).standard_normal(64).view(np.complex128)
    y = np.kron(*signatures.at(LOOK.nu + 0.02)) + 0.1 * noise
    low, high = LOOK._replace(limit=1.0), LOOK._replace(limit=1e9)
    hit = DataSet(y, signatures, Processing(is_steered=True, monopulse=True)).measure(low, 3.0)
    assert 0.0 < hit.nu_sigma < 0.02
    assert hit.nu_hat == pytest.approx(LOOK.nu + 0.02, abs=4 * hit.nu_sigma)
    plain = wald_test(y, *signatures.at(LOOK.nu))
    assert hit.cell == plain._replace(sigma_hat=hit.cell.sigma_hat)
    assert hit.cell.sigma_hat < plain.sigma_hat  # which has in it what the cell does not match of the echo
    for look, monopulse in ((low, False), (high, True)):
        assert DataSet(y, signatures, Processing(monopulse, monopulse)).measure(look, 3.0) == (
            look,
            plain,
            3.0,
            look.nu,
            0.0,
        )


def test_an_echo_in_two_range_cells_is_reported_once_and_two_echoes_are_reported_both() -> None:
    look = LOOK._replace(cells=range(99, 103), limit=20.0)
    strong = Measured(look, Cell(200.0, 1.0 + 0j, 0.1, 1.0), 50.25, look.nu, 0.0)
    for range_km, alpha, is_reported in (
        (50.75, 0.6 + 0.1j, False),
        (49.75, 0.6 - 0.2j, False),
        (50.75, 0.6 + 0.5j, True),  # not in phase: of another target
        (50.75, -0.6 + 0j, True),
        (51.25, 0.6 + 0j, True),  # two cells away
    ):
        weak = Measured(look, Cell(72.0, alpha, 0.1, 1.0), range_km, look.nu, 0.0)
        assert reported([weak, strong], 0.5) == ([strong, weak] if is_reported else [strong])
        assert reported([weak, strong]) == [strong, weak]
