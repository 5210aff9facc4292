"""What an array receives besides disturbance and targets: jammers, and clutter that echoes the waveform.

Symbols: Y data set of a range cell, (n_tx, n_rx); k dwell; W waveform; a(nu) steering vector.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import power, tan, times
from cogradar.shared.numerics.linear import product
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.radar_config import ArraySection
from cogradar.shared.scenario.world_config import ClutterSection, JammerSection
from cogradar.shared.signal.waveform import Signatures

Complexes = NDArray[np.complex128]
_CELL_KEY = 1 << 32  # between the keys of one jammer's range cells, more than there can be range cells


Add = Callable[[Complexes, int], None]  # to a data set (n_tx, n_rx), in place, of a range cell of this number


class Source(Protocol):
    """Something that is in the data sets of all range cells."""

    def during(self, k: int, time_s: float, signatures: Signatures) -> Add | None:
        """What adds it in dwell k at this time, with the signatures of the real array; None: it is not there."""


class Jammer:
    """Noise from one direction, on while its time has come.

        Y += sqrt(JNR) g a_R(nu)^T,   g ~ CN(0, I) of n_tx channels, anew in each range cell and dwell

    Its noise is not matched to any transmitted waveform: it is independent from transmit channel to transmit channel,
    whatever W is.
    """

    def __init__(self, section: JammerSection, index: int, seed: int) -> None:
        """index : number of the jammer, from 0."""
        self._amplitude, self._nu = float(10.0 ** (section.jnr_db / 20.0)), section.nu
        self._on_s, self._off_s = section.on_s, section.off_s
        self._index, self._seed = index, seed

    def during(self, k: int, time_s: float, signatures: Signatures) -> Add | None:
        """From when it is switched on until it is switched off."""
        is_on = self._on_s <= time_s and (self._off_s is None or time_s < self._off_s)
        return partial(self._add, k, signatures.at(self._nu)[1]) if is_on else None

    def _add(self, k: int, received: Complexes, y: Complexes, range_cell: int) -> None:
        """received: (n_rx,) a_R of its direction."""
        rng = generator(self._seed, Purpose.JAMMER, self._index * _CELL_KEY + range_cell, k)
        g = self._amplitude * np.sqrt(0.5) * rng.standard_normal(2 * y.shape[0]).view(np.complex128)
        y += times(g[:, np.newaxis], received)


class Clutter:
    """Ground that echoes the waveform: patches at equal steps of the angle, alike in all range cells.

        Y += sum_q gamma_q(k) (W^T a_T(nu_q)) a_R(nu_q)^T,   gamma_q(k) = g_q A_q e^{j k psi_q}
        A_q ~ CN(0, CNR n_tx / (P n_patch)),   psi_q wrapped Cauchy of resultant rho

    CNR is the power in an element of Y while the power P goes in all directions, of isotropic antennas. Each patch
    turns by a phase of its own from dwell to dwell: E gamma(k) gamma(k')^* = E |gamma|^2 rho^|k - k'| is the
    correlation of a first-order autoregression, yet dwell k is a function of its number, and no dwell before it has to
    be computed.
    """

    def __init__(self, section: ClutterSection, array: ArraySection, pattern_exponent: float, seed: int) -> None:
        """pattern_exponent : q of the power pattern cos^q of an element."""
        n, self._seed = section.patches, seed
        angles = np.pi * ((np.arange(n) + 0.5) / n - 0.5)
        self._nus: list[float] = (0.5 * np.sin(angles)).tolist()
        level = 10.0 ** (section.cnr_db / 10.0) * array.n_tx / (array.power * n)
        self._amplitudes = np.sqrt(0.5 * level) * power(np.cos(angles), pattern_exponent)
        self._spread = -math.log(section.correlation)

    def during(self, k: int, _time_s: float, signatures: Signatures) -> Add:
        """In each dwell."""
        signatures.prepare(self._nus)
        sent, received = (np.array(half) for half in zip(*map(signatures.at, self._nus), strict=True))
        return partial(self._add, k, sent, received)

    def _add(self, k: int, sent: Complexes, received: Complexes, y: Complexes, range_cell: int) -> None:
        """Signatures of the patches: sent (n_patch, n_tx) W^T a_T, received (n_patch, n_rx) a_R."""
        y += product(times(sent, self.echoes(range_cell, k)[:, np.newaxis]).T, received)

    def echoes(self, range_cell: int, k: int) -> Complexes:
        """gamma_q of the patches of a range cell in dwell k, (n_patch,)."""
        rng = generator(self._seed, Purpose.CLUTTER, range_cell, 0)
        a = self._amplitudes * rng.standard_normal(2 * len(self._nus)).view(np.complex128)
        turns = np.remainder(self._spread * tan(np.pi * (rng.random(len(self._nus)) - 0.5)), 2.0 * np.pi)
        return times(a, np.exp(1j * k * turns))
