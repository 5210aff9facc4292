"""Noise from other range cells: false alarms beside a line and a texture, and P_D in closed form of every estimate."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.services.emulator.cycle import transmission
from cogradar.services.emulator.front_end import receive
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario import cross_checks
from cogradar.shared.scenario.document import ScenarioError
from cogradar.shared.scenario.files import load
from cogradar.shared.scoring.finite_size import finite_size
from cogradar.shared.signal.array import steering_vector
from cogradar.shared.signal.detector import levels
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.detector.levels import (
    FEWEST_REFERENCES,
    MOST_REFERENCES,
    level_of,
    range_levels,
    references,
)
from cogradar.shared.signal.detector.reception import receive as measured_of
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import Signatures, beam_factor
from cogradar.shared.world.disturbance import draw

N, CELLS = 20, range(10, 74)
NUS = np.linspace(-0.5, 0.5, N)
LINE = NUS[13] + 0.005  # beside a look, so that neighbours hear it, too
RANGE = Processing(is_steered=True, monopulse=False, by_rows=True, by_range=True)
ROWS = RANGE._replace(by_range=False)
ISOTROPIC = Signatures(float(N), np.empty((N, 0), np.complex128), N)
BEAMS = Signatures(2.0, beam_factor([-0.3, LINE + 0.01, 0.4], [6.0, 6.0, 6.0], N), N)


def sea(rng: np.random.Generator, n: int, line_db: float, *, has_texture: bool = True) -> NDArray[np.complex128]:
    """I/Q of n range cells: correlated noise and a line in one direction, both with one impulsive texture; (n, N N).

    The line is coherent along transmit and receive channels, as the echo of a target there would be.
    """
    w = np.sqrt(0.5) * rng.standard_normal((n, N, 2 * N)).view(np.complex128)
    for i in range(1, N):
        w[:, :, i] = np.sqrt(1.0 - 0.36) * w[:, :, i] + 0.6 * np.exp(0.2j * np.pi) * w[:, :, i - 1]
    a = steering_vector(LINE, N)
    g = 10.0 ** (line_db / 20.0) * np.sqrt(0.5) * rng.standard_normal(2 * n).view(np.complex128)
    texture = 1.0 / rng.standard_gamma(2.0, n) if has_texture else np.ones(n)
    y = np.sqrt(texture)[:, np.newaxis, np.newaxis] * (w + np.multiply.outer(g, np.outer(a, a)))
    return np.asarray(y.reshape(n, -1), np.complex128)


def false_alarms(
    signatures: Signatures, processing: Processing, p_fas: tuple[float, ...], dwells: int, line_db: float
) -> NDArray[np.float64]:
    """Share of range cells over the limit, (p_fas, looks)."""
    rng, hits = np.random.default_rng(6), np.zeros((len(p_fas), N))
    looks = [Look(nu, i, CELLS, threshold(p_fas[0])) for i, nu in enumerate(NUS.tolist())]
    others = references(CELLS) if processing.by_range else ()
    for _ in range(dwells):
        data = {cell: DataSet(y, signatures, processing) for cell, y in zip(CELLS, sea(rng, 64, line_db), strict=True)}
        for row in measured_of(looks, data.__getitem__, CELLS, 1.0, others=others):
            hits[:, row.look.bin] += [row.cell.statistic >= threshold(p_fa) for p_fa in p_fas]
    return hits / (dwells * len(CELLS))


@pytest.mark.parametrize("signatures", [ISOTROPIC, BEAMS])
def test_a_line_and_a_texture_make_no_more_false_alarms_than_nominal(signatures: Signatures) -> None:
    """Of each data set itself the looks at the line exceed a limit for 1e-4 in most range cells."""
    p_fas, dwells = (1e-2, 1e-3, 1e-4), 120
    found = false_alarms(signatures, RANGE, p_fas, dwells, 20.0)
    n = dwells * len(CELLS)
    for p_fa, shares in zip(p_fas, found, strict=True):
        assert shares.max() < 1.4 * p_fa + 5.0 * np.sqrt(p_fa / n)  # the worst of all looks
    assert 0.5e-2 < found[0].mean() < 1.2e-2
    assert found[2].mean() < 2e-4
    assert false_alarms(signatures, ROWS, p_fas, 5, 20.0)[2].max() > 0.5


def test_a_level_is_that_of_the_noise_beside_a_line_and_an_echo() -> None:
    rng, a = np.random.default_rng(3), steering_vector(-0.2, N)
    plain, lit = sea(rng, 200, -99.0, has_texture=False), sea(rng, 200, 20.0, has_texture=False)
    lit += 10.0 * np.outer(a, a).ravel()
    found = np.array([[level_of(y, N) for y in data] for data in (plain, lit)])
    assert found[1].mean() == pytest.approx(found[0].mean(), rel=0.15)
    assert found[0].std() / found[0].mean() < np.sqrt(1.2 * levels.LEVEL_SPREAD / N**2)
    assert level_of(9.0 * plain[0], N) == pytest.approx(81.0 * found[0, 0])


def test_targets_in_other_range_cells_do_not_hide_one() -> None:
    rng, a = np.random.default_rng(4), steering_vector(0.1, N)
    look = Look(0.1, 12, range(40, 41), threshold(1e-4))
    statistics = []
    for strong in (0.0, 3.0):
        rng = np.random.default_rng(4)
        data = sea(rng, 64, 10.0, has_texture=False)
        data[30] += 0.5 * np.outer(a, a).ravel()
        for i in (3, 17, 44, 51):
            data[i] += strong * np.outer(a, a).ravel()
        sets = {cell: DataSet(y, ISOTROPIC, RANGE) for cell, y in zip(CELLS, data, strict=True)}
        (row,) = measured_of([look], sets.__getitem__, CELLS, 1.0, others=references(CELLS))
        statistics.append(row.cell.statistic)
    assert statistics[1] == pytest.approx(statistics[0], rel=0.25)
    assert min(statistics) > look.limit


@pytest.mark.parametrize("signatures", [ISOTROPIC, BEAMS])
@pytest.mark.parametrize("noise", ["lags", "rows", "range-cells"])
def test_p_d_is_that_of_the_closed_form(noise: str, signatures: Signatures) -> None:
    nu, limit, n = -0.3, threshold(1e-3), 1500
    own = signatures.at(nu)
    v = np.kron(*own).astype(np.complex128)
    form = finite_size("ar6-t", nu, v, noise, N)
    power = float(np.vdot(v, v).real)
    snr = 11.0 * form.level / power  # P_D about .8
    expected = float(form.detection_probability(snr, power, limit))
    processing = Processing(is_steered=True, monopulse=False, by_rows=noise != "lags", by_range=noise == "range-cells")
    look, hits = Look(nu, 3, range(10, 11), limit), 0
    others = tuple(range(20, 84)) if processing.by_range else ()
    for i in range(n):
        if i % 25 == 0:  # others are drawn anew now and then only, and stay independent of the cell that is tested
            data = {j: DataSet(drawn(i, j), signatures, processing) for j in others}
        y = drawn(i, 10) + np.sqrt(snr) * np.exp(2j * np.pi * i / 7.1) * v
        data[10] = DataSet(y, signatures, processing)
        (row,) = measured_of([look], data.__getitem__, [10], 1.0, others=others)
        hits += row.cell.statistic >= limit
    assert hits / n == pytest.approx(expected, abs=5.0 * np.sqrt(0.16 / n) + 0.01)
    assert 0.5 < expected < 0.95


def drawn(i: int, j: int) -> NDArray[np.complex128]:
    return draw("ar6-t", N * N, generator(1, Purpose.DISTURBANCE, j, i))


def test_the_loss_of_an_estimate_from_range_cells_is_below_1_db() -> None:
    """Against noise that is known: how much more signal the same P_D takes, at 1e-4 with 100 x 100 channels."""
    a, limit = steering_vector(0.1, 100), threshold(1e-4)
    v = np.kron(a, a).astype(np.complex128)
    form = finite_size("white", 0.1, v, "range-cells", 100)
    snr = 10.0 ** (np.arange(0.0, 25.0, 0.01) / 10.0) / v.size
    known = form._replace(dof=1e6, band_mean=form.level)
    needed = [
        np.interp(0.8, one.detection_probability(snr, v.size, limit), 10.0 * np.log10(snr)) for one in (known, form)
    ]
    assert 0.2 < needed[1] - needed[0] < 0.5


def test_silence_in_all_other_range_cells_is_no_estimate() -> None:
    found = range_levels(np.zeros((20, 3)), np.zeros(20), 100)
    assert found.constant.tolist() == found.per_level.tolist() == [0.0, 0.0, 0.0]


def test_too_few_range_cells_are_refused() -> None:
    assert cross_checks.FEWEST_RANGE_CELLS == FEWEST_REFERENCES < MOST_REFERENCES
    for settings, said in (
        (["radar.receiver.range_cell_km=20.0"], "needs 16 range cells between .* has 9"),
        (["radar.receiver.range_cell_km=0.0"], "has 1: set a smaller radar.receiver.range_cell_km above 0"),
        (["world.signal=cells"], 'needs world.signal = "array"'),
    ):
        with pytest.raises(ScenarioError, match=said):
            load(
                "smoke",
                ["radar.fidelity=best-range", "world.signal=array", "radar.receiver.noise=range-cells", *settings],
            )
    radar = load("smoke", ["radar.fidelity=best-range", "world.signal=array", "radar.receiver.noise=range-cells"]).radar
    waveform = transmission(radar, None)
    scan = receive({i: np.ones((16, 16), complex) for i in range(20, 35)}, waveform, radar)
    assert scan.bins.size == 0
    assert re.search("data of 15 range cells, .* needs 16 at least", scan.fault or "")


def test_a_front_end_s_data_are_tested_with_other_range_cells() -> None:
    radar = load("smoke", ["radar.fidelity=best-range", "world.signal=array", "radar.receiver.noise=range-cells"]).radar
    rng, waveform = np.random.default_rng(1), transmission(radar, None)
    data = {i: rng.standard_normal((16, 32)).view(np.complex128) for i in waveform.range_cells[:40]}
    scan = receive(data, waveform, radar)
    assert (scan.statistic < scan.limits).all() if scan.limits is not None else False
    data[waveform.range_cells[7]] += 4.0 * np.outer(steering_vector(0.1, 16), steering_vector(0.1, 16))
    scan = receive(data, waveform, radar)
    assert scan.nus is not None
    assert abs(scan.nus[scan.statistic.argmax()] - 0.1) < 0.04
