"""The Wald test of many directions from one data set: what an array delivers of a range cell in a dwell.

Symbols: Y data set, n_tx x n_rx, transmit channel by transmit channel; v = u kron a_R signature, u = W^T a_T;
l lags of the covariance estimate; w_0 level of an isotropic waveform W = w_0 I.
"""

from functools import cached_property
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import modulus, squared_modulus, times, whole_power
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import product
from cogradar.shared.signal.detector.levels import Levels, level_of
from cogradar.shared.signal.detector.separation import (
    Echoes,
    as_chi_square,
    beside,
    find_echoes,
    fit,
    is_beside,
    is_beside_each,
    no_echoes,
    power_beside,
    row_tests,
    without,
)
from cogradar.shared.signal.looks import Look, Measured
from cogradar.shared.signal.monopulse import direction, flat_ratio_sigma, off_axis_echo
from cogradar.shared.signal.receiver import Cell, n_lag, wald_test
from cogradar.shared.signal.waveform import Signatures

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]


SCREENED = 0.5  # share of its limit below which a statistic beside other echoes may be approximate
_TINY = 1e-300


class Cells(NamedTuple):
    """What the receiver says of n directions, (n,) each; with the fields of `Cell`."""

    statistic: Floats
    alpha_hat: Complexes
    sigma_hat: Floats
    signature_power: Floats

    @classmethod
    def of(cls, alpha_hat: Complexes, b: Floats, signature_power: Floats, dof: Floats | None = None) -> Self:
        """From the sums B of the receiver; Lambda and sigma_hat are 0 if B <= 0.

        dof : (n,) as for `as_chi_square`; None: 0
        """
        statistic, sigma_hat = _statistics(alpha_hat, b, signature_power)
        if dof is not None:
            statistic = as_chi_square(statistic, dof)
        return cls(statistic, alpha_hat, sigma_hat, signature_power)

    def cell(self, i: int) -> Cell:
        """Of the i-th direction."""
        return Cell(
            float(self.statistic[i]),
            complex(self.alpha_hat[i]),
            float(self.sigma_hat[i]),
            float(self.signature_power[i]),
        )


class Chosen(Protocol):
    """The keys of `radar.receiver` that say how data are tested."""

    @property
    def cells(self) -> str: ...
    @property
    def monopulse(self) -> bool: ...
    @property
    def noise(self) -> str: ...
    @property
    def separation(self) -> str: ...


class Processing(NamedTuple):
    """How data are tested: `radar.receiver`."""

    is_steered: bool  # a detection is not of its bin, but of a direction
    monopulse: bool  # which is measured
    by_rows: bool = False  # the noise is estimated from clusters and not by lags
    separates: bool = False  # other echoes are told apart
    by_range: bool = False  # the noise is estimated from other range cells

    @classmethod
    def of(cls, section: Chosen) -> Self:
        """As a scenario has it."""
        is_steered, by_rows = section.cells == "steered", section.noise != "lags"
        separates, by_range = section.separation == "joint", section.noise == "range-cells"
        return cls(is_steered, section.monopulse, by_rows, separates, by_range)


class DataSet:
    """What an array delivers of a range cell in a dwell, or one cell alone, and what the receiver makes of it."""

    def __init__(self, y: Complexes, signatures: Signatures, processing: Processing) -> None:
        """y : (n_tx n_rx,) complex, Y transmit channel by transmit channel."""
        self._y, self._signatures, self._processing = y, signatures, processing
        self._lags = 0 if processing.by_rows else n_lag(y.size)

    @cached_property
    def echoes(self) -> Echoes:
        """What is told apart."""
        if self._processing.separates:
            return find_echoes(self._y, self._signatures)
        return no_echoes(self._y.size // self._signatures.n_rx, self._signatures.n_rx)

    @cached_property
    def _left(self) -> "DataSet":
        """What all echoes leave, in which none is told apart."""
        left = without(self._y, self.echoes, np.ones(self.echoes.nus.size, np.bool_))
        return DataSet(left, self._signatures, self._processing._replace(separates=False))

    @cached_property
    def level(self) -> float:
        """Of what all echoes leave, as other range cells' levels are compared with (`levels`)."""
        return level_of(self._left.data if self.echoes.nus.size else self._y, self._signatures.n_rx)

    @property
    def data(self) -> Complexes:
        """y, (n_tx n_rx,)."""
        return self._y

    def powers(self, nus: Floats) -> Floats:
        """|alpha_hat|^2 of n directions in what all echoes leave, (n,); 0 where nothing is sent."""
        if self.echoes.nus.size:
            return self._left.powers(nus)
        z, u, power = self._beamformed(nus)
        alphas = np.sum(times(u.conj(), z), axis=1) / np.maximum(power, _TINY)
        return np.asarray(squared_modulus(alphas))

    def tests_beside(self, nus: Floats, levels: Levels) -> Cells:
        """The tests of n directions with the noise of other range cells."""
        cells = self.tests(nus, np.full(nus.size, np.inf))  # no estimate of this data set's own is needed
        whole = self._beamformed(nus)[2]
        variance = (levels.constant + levels.per_level * self.level) * whole / np.maximum(cells.signature_power, _TINY)
        return Cells.of(cells.alpha_hat, variance * cells.signature_power**2, cells.signature_power, levels.dof)

    def tests(self, nus: Floats, limits: Floats | None = None) -> Cells:
        """The tests of n directions.

        limits : (n,) that statistics are compared with. Where a statistic beside other echoes is far below its limit,
                 it is the statistic of what these leave, right to some per cent. None: all are exact
        """
        if self.echoes.nus.size == 0:
            return self._row_tests(nus) if self._processing.by_rows else wald_tests(self._y, self._signatures, nus)
        if limits is None:
            return self._fits(nus)
        cells, is_beside_all = self._screened(nus), is_beside_each(self.echoes, nus).all(axis=1)
        at = np.flatnonzero(~is_beside_all | (cells.statistic >= SCREENED * limits))
        for column, exact in zip(cells, self._fits(nus[at]), strict=True):
            column[at] = exact
        return cells

    def _screened(self, nus: Floats) -> Cells:
        """Tests of n directions outside of the main lobes of all echoes, from what these leave, r.

        With P = ||v||^2 and P' = what is left of it beside the echoes, alpha_hat = v^H r / P' is exact. Of B it is
        assumed that the part of v beside the echoes meets the same noise as v: Lambda of r is multiplied by P / P'.
        """
        cells, halves = self._left.tests(nus), [self._signatures.at(nu) for nu in nus.tolist()]
        power = power_beside(self.echoes, *(np.array(half) for half in zip(*halves, strict=True)))
        share = np.where(cells.signature_power > 0.0, power / np.maximum(cells.signature_power, _TINY), 1.0)
        sigma_hat = cells.sigma_hat / np.sqrt(share)
        return Cells(cells.statistic / share, cells.alpha_hat / share, sigma_hat, power)

    def _fits(self, nus: Floats) -> Cells:
        """Tests of n directions beside other echoes."""
        fits = [fit(self._y, self._signatures.at(nu), beside(self.echoes, nu), self._lags) for nu in nus.tolist()]
        alpha_hat = np.array([one.alpha_hat for one in fits], np.complex128)
        b, power, dof = np.array([one[1:] for one in fits], np.float64).reshape(-1, 3).T
        return Cells.of(alpha_hat, b * power**2, power, dof)

    def measure(self, look: Look, range_km: float) -> Measured:
        """Test a look, and measure the direction of what is detected.

        range_km : centre of the range cell; 0: there is none
        """
        if self.echoes.nus.size or self._processing.by_rows:
            cell = self.tests(np.array([look.nu])).cell(0)
        else:
            cell = wald_test(self._y, *self._signatures.at(look.nu))
        return self.located(Measured(look, cell, range_km, look.nu, 0.0))

    def located(self, measured: Measured) -> Measured:
        """With the direction of an echo that is over the limit of a steered cell.

        What the cell's signature does not match of an echo off its axis is in the residual, and makes sigma_hat too
        large. Then r is at most some sqrt(N D^4 / ((1 - D^4) (2 l + 1))), D^2 the two-way loss, however strong the
        echo. So once its direction is measured, sigma_hat is estimated from what the echo from there leaves; alpha_hat
        stays the cell's own.
        """
        look, cell, processing = measured.look, measured.cell, self._processing
        if not processing.is_steered or cell.statistic < look.limit:
            return measured
        if processing.by_range:
            return self._located_by_range(measured)
        own, y, is_told_apart = self._signatures.at(look.nu), self._y, False
        if self.echoes.nus.size:
            is_other = is_beside(self.echoes, look.nu)
            is_told_apart = bool(is_other.any())
            y = without(y, self.echoes, is_other) if is_told_apart else y
        rho, rho_sigma, sigma_hat = off_axis_echo(y, own, self._signatures.root, look.nu, self._lags)
        # Beside other echoes less is left of the signature, and alpha_hat is less certain.
        whole = self._signatures.power_at(look.nu)
        sigma_hat *= np.sqrt(whole / cell.signature_power) if is_told_apart else 1.0
        cell = cell._replace(sigma_hat=sigma_hat or cell.sigma_hat)
        if not processing.monopulse:
            return measured._replace(cell=cell)
        n = own[1].size
        if rho_sigma == 0.0:
            rho_sigma = flat_ratio_sigma(rho, modulus(cell.alpha_hat) / cell.sigma_hat, n)
        return Measured(look, cell, measured.range_km, *direction(look.nu, rho, rho_sigma, n))

    def _located_by_range(self, measured: Measured) -> Measured:
        """With the direction of a detection, if other range cells say what its noise is."""
        look, cell = measured.look, measured.cell
        if not self._processing.monopulse:
            return measured
        own, is_other, y = self._signatures.at(look.nu), is_beside(self.echoes, look.nu), self._y
        if is_other.any():
            y = without(y, self.echoes, is_other)
        rho, n = off_axis_echo(y, own, self._signatures.root, look.nu, self._lags)[0], own[1].size
        rho_sigma = flat_ratio_sigma(rho, modulus(cell.alpha_hat) / cell.sigma_hat, n)
        return Measured(look, cell, measured.range_km, *direction(look.nu, rho, rho_sigma, n))

    def _row_tests(self, nus: Floats) -> Cells:
        """Without other echoes, rows as clusters."""
        z, u, _ = self._beamformed(nus)
        alpha_hat, b, power, dof = row_tests(z, u, self._signatures.n_rx)
        return Cells.of(alpha_hat, b, power, dof)

    def _beamformed(self, nus: Floats) -> tuple[Complexes, Complexes, Floats]:
        """Y a_R^* and W^T a_T of n directions, (n, n_tx) each, and ||v||^2, (n,)."""
        n_rx, y = self._signatures.n_rx, self._y
        halves = [self._signatures.at(nu) for nu in nus.tolist()]
        u = np.array([one for one, _ in halves], np.complex128).reshape(-1, y.size // n_rx)
        a = np.array([one for _, one in halves], np.complex128).reshape(-1, n_rx)
        return product(y.reshape(-1, n_rx), a.conj().T).T, u, np.sum(squared_modulus(u), axis=1) * n_rx


def wald_tests(y: Complexes, signatures: Signatures, nus: Floats) -> Cells:
    """`wald_test` of each direction, from one data set.

    y       : (n_tx n_rx,) complex, Y transmit channel by transmit channel
    nus     : (n,) spatial frequencies
    returns : Cells of n directions, equal to `wald_test` to rounding

    An isotropic waveform takes 2 us a direction and 0.1 ms a data set of 10^4 channels. With beams each direction takes
    60 us.
    """
    level, n_rx = signatures.isotropic_level, signatures.n_rx
    if level is not None and n_lag(y.size) <= n_rx:
        return _isotropic_wald_tests(y, n_rx, level, nus)
    cells = [wald_test(y, *signatures.at(nu)) for nu in nus.tolist()]
    columns = zip(*cells, strict=True) if cells else [[]] * 4
    kinds = (np.float64, np.complex128, np.float64, np.float64)
    return Cells(*(np.array(column, dtype=kind) for column, kind in zip(columns, kinds, strict=True)))


def _isotropic_wald_tests(y: Complexes, n_rx: int, level: float, nus: Floats) -> Cells:
    """The tests under W = w_0 I, whose signature w_0 exp(j 2 pi nu (i + r)) depends on i + r alone.

        D_s = sum_{i + r = s} Y_ir,   alpha_hat = sum_s D_s exp(-j 2 pi nu s) / (w_0 N)
        B = S_0 + 2 Re sum_{m=1..l} S_m,   S_m = sum_n x_n x_{n-m}^*,   x_n = y_n v_n^* - c,   c = alpha_hat w_0^2
        sum_n y_n v_n^* (y_{n-m} v_{n-m}^*)^* = w_0^2 (e^{-j 2 pi nu m} P_m + e^{-j 2 pi nu (m + 1 - n_rx)} Q_m)

    P_m are sums over lags m within a transmit channel, Q_m over lags that reach into the channel before; both are sums
    of Y, whatever the direction. Of x only the first and the last l elements are needed besides.

    y     : (n_tx n_rx,) complex; n_rx >= l = ceil((n_tx n_rx)^{1/4})
    level : w_0 >= 0
    nus   : (n,) spatial frequencies
    """
    power = np.full(nus.size, level**2 * y.size)
    if level == 0.0:
        return Cells.of(np.zeros(nus.size, dtype=np.complex128), np.zeros(nus.size), power)
    alpha_hat, b = _isotropic(y, n_rx, n_lag(y.size), level, np.exp(-2j * np.pi * nus))
    return Cells.of(alpha_hat, b, power)


@kernel
def _isotropic(y: Complexes, n_rx: int, n_lag: int, level: float, steps: Complexes) -> tuple[Complexes, Floats]:
    """alpha_hat and B of directions, (n,) each; steps: (n,) exp(-j 2 pi nu)."""
    n = y.size
    n_tx = n // n_rx
    re, im = np.zeros(n_lag + n), np.zeros(n_lag + n)
    re[n_lag:], im[n_lag:] = y.real, y.imag
    summed_re, summed_im = np.zeros(n_tx + n_rx - 1), np.zeros(n_tx + n_rx - 1)
    lag_re, lag_im = np.zeros((n_lag + 1, n_rx)), np.zeros((n_lag + 1, n_rx))
    for i in range(n_tx):
        first = n_lag + i * n_rx
        row_re, row_im = re[first : first + n_rx], im[first : first + n_rx]
        _add(row_re, row_im, summed_re[i : i + n_rx], summed_im[i : i + n_rx])
        for m in range(n_lag + 1):
            before_re, before_im = re[first - m : first - m + n_rx], im[first - m : first - m + n_rx]
            _add_products(row_re, row_im, before_re, before_im, lag_re[m], lag_im[m])
    within, across = np.empty(n_lag + 1, dtype=np.complex128), np.empty(n_lag + 1, dtype=np.complex128)
    for m in range(n_lag + 1):
        within[m] = complex(np.sum(lag_re[m, m:]), np.sum(lag_im[m, m:]))
        across[m] = complex(np.sum(lag_re[m, :m]), np.sum(lag_im[m, :m]))
    totals, ends = _transform(summed_re, summed_im, steps)
    alphas, bs = totals / (level * n), np.empty(steps.size)
    for j in range(steps.size):
        step, c, first_sum, last_sum, turn = steps[j], alphas[j] * level * level, 0j, 0j, 1.0 + 0j
        into_last_channel = whole_power(np.conj(step), n_rx - 1)
        own = level * level * within[0].real - n * (c.real * c.real + c.imag * c.imag)
        cross = 0.0
        for m in range(1, n_lag + 1):
            first_sum += level * y[m - 1] * turn
            turn *= step
            last_sum += level * y[n - m] * ends[j] * np.conj(turn)
            product = level * level * turn * (within[m] + into_last_channel * across[m])
            product += np.conj(c) * first_sum + c * np.conj(last_sum) - (n + m) * c * np.conj(c)
            cross += product.real
        bs[j] = own + 2.0 * cross
    return alphas, bs


@kernel
def _statistics(alpha_hat: Complexes, b: Floats, signature_power: Floats) -> tuple[Floats, Floats]:
    """Lambda = 2 |alpha_hat|^2 / sigma_hat^2 and sigma_hat = sqrt(B) / ||v||^2, (n,) each; 0 if B <= 0."""
    statistic, sigma_hat = np.zeros(b.size), np.zeros(b.size)
    for j in range(b.size):
        if b[j] > 0.0:
            sigma_hat[j] = np.sqrt(b[j]) / signature_power[j]
            statistic[j] = 2.0 * (modulus(alpha_hat[j]) / sigma_hat[j]) ** 2
    return statistic, sigma_hat


# Loops over the row of one transmit channel, in functions of their own: only so does the compiler vectorise them.


@kernel
def _add(row_re: Floats, row_im: Floats, total_re: Floats, total_im: Floats) -> None:
    """total += row."""
    for r in range(row_re.size):
        total_re[r] += row_re[r]
        total_im[r] += row_im[r]


@kernel
def _add_products(
    row_re: Floats, row_im: Floats, before_re: Floats, before_im: Floats, total_re: Floats, total_im: Floats
) -> None:
    """total += row before^*."""
    for r in range(row_re.size):
        total_re[r] += row_re[r] * before_re[r] + row_im[r] * before_im[r]
        total_im[r] += row_im[r] * before_re[r] - row_re[r] * before_im[r]


@kernel
def _transform(summed_re: Floats, summed_im: Floats, steps: Complexes) -> tuple[Complexes, Complexes]:
    """sum_s D_s step^s of each direction, and step to the power of the number of terms."""
    re, im, step_re, step_im = np.ones(steps.size), np.zeros(steps.size), steps.real.copy(), steps.imag.copy()
    total_re, total_im = np.zeros(steps.size), np.zeros(steps.size)
    for s in range(summed_re.size):
        _add_turned(summed_re[s], summed_im[s], re, im, total_re, total_im)
        _turn(step_re, step_im, re, im)
    return total_re + 1j * total_im, re + 1j * im


@kernel
def _add_turned(x: float, y: float, re: Floats, im: Floats, total_re: Floats, total_im: Floats) -> None:
    """total += (x + j y)(re + j im)."""
    for j in range(re.size):
        total_re[j] += x * re[j] - y * im[j]
        total_im[j] += x * im[j] + y * re[j]


@kernel
def _turn(step_re: Floats, step_im: Floats, re: Floats, im: Floats) -> None:
    """re + j im, each times its step."""
    for j in range(re.size):
        turned = re[j] * step_re[j] - im[j] * step_im[j]
        im[j] = re[j] * step_im[j] + im[j] * step_re[j]
        re[j] = turned
