"""The world of an array: every look of a range cell is tested with one data set, and each target is in it.

    Y = C + sum_j g_j alpha_j s(R_j) (W^T a_T(nu_j)) a_R(nu_j)^T,   (n_tx, n_rx) after matched filtering

C      : disturbance of a range cell and dwell, keyed by both; along the transmit channels it follows
         `world.disturbance`, whatever is transmitted
g_j    : cos^q of the angle from boresight, the element's power pattern cos^q sent and received (amplitudes)
s(R_j) : sinc(R_j / w - i - 1/2) of range cell i of width w, in the two nearest cells; 1 without range cells

The radar does not know the errors of its antennas: its looks have the signatures of an array without errors, echoes and
jammers the signatures of the array as it is (`antennas`). Jammers and clutter (`interference`) are added to the data
sets of all range cells.

Directions have no grid and a look no reach: a target is heard through the sidelobes of every look, and directions
-0.5 and 0.5 are one. All targets are summed before anything is tested.

A recorded disturbance is cut out of its file (`cogradar.shared.signal.recording`): dwell k has the k-th part of it.

Exact are all range cells with an echo, and all range cells of all looks while a jammer is on, or with clutter or a
recording. Each look of such a cell is tested with its Y. Of the other cells of a look the largest statistic is drawn
from its distribution (`Scene`), independent of other looks. Without range cells all is exact.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import power
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.world_config import WorldArraySection, WorldConfig
from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.signal.detector.data_set import DataSet
from cogradar.shared.signal.detector.levels import references
from cogradar.shared.signal.detector.reception import LookTable, receive
from cogradar.shared.signal.looks import NO_RANGE, Look, Measured, range_cells
from cogradar.shared.signal.waveform import Signatures
from cogradar.shared.world.antennas import elements
from cogradar.shared.world.interference import Add, Clutter, Jammer, Source
from cogradar.shared.world.scene import Place, Scene, add_echo

Complexes = NDArray[np.complex128]
KEPT_BYTES = 1 << 26  # of data sets of a dwell, until the directions of what was detected are measured
_ALL_BINS = 0  # in place of the bin of a disturbance
Echoes = Mapping[int, Sequence[tuple[float, complex]]]  # by range cell: direction and amplitude of what is in it


class ArrayScene(Scene):
    """A scene in which all looks of a range cell share what the array received."""

    def __init__(self, world: WorldConfig, radar: RadarConfig, seed: int, t: int) -> None:
        """The scene at clock t."""
        super().__init__(world, radar, seed, t)
        antennas, section = world.array or WorldArraySection(), world.disturbance.recording
        self._recording = None if section is None else section.read(radar.array.n_tx, radar.array.n_rx)
        ends, width = radar.acquisition.ranges_km, radar.receiver.range_cell_km
        self._range_cells = range_cells(*ends, width) if width > 0.0 else range(NO_RANGE, NO_RANGE + 1)
        exponent, self._elements = antennas.pattern_exponent, elements(antennas, radar.array, seed)
        self._pattern_exponent, self._dt_s = exponent, radar.motion.dt_s
        self._sources: list[Source] = [Jammer(section, i, seed) for i, section in enumerate(world.jammers)]
        if world.clutter is not None:
            self._sources.append(Clutter(world.clutter, radar.array, exponent, seed))

    def observe(
        self, k: int, isotropic: float, factor: NDArray[np.complex128], looks: Sequence[Look]
    ) -> list[Measured]:
        echoes, self.drawn, table = self._echoes(k), [], LookTable.of(looks)
        signatures = Signatures(isotropic, factor, self._array.n_rx)
        signatures.prepare(table.nus.tolist())
        self._work_out_levels(looks)
        # The radar tests with the signatures that it assumes; echoes have the real antennas' signatures.
        real = signatures
        if self._elements is not None:
            real = Signatures(isotropic, factor, self._array.n_rx, self._elements)
        real.prepare([nu for cell in echoes.values() for nu, _ in cell])
        found = (source.during(k, self.t * self._dt_s, real) for source in self._sources)
        interference = [add for add in found if add is not None]
        is_all = interference or self._recording is not None
        exact = [cell for cell in table.range_cells() if is_all or cell in echoes or cell == NO_RANGE]
        most = max(KEPT_BYTES // (np.dtype(np.complex128).itemsize * self._array.n_tx * self._array.n_rx), 1)

        @lru_cache(most)
        def received(cell: int) -> DataSet:
            return DataSet(self._received(k, cell, echoes, interference, real), signatures, self._processing)

        def loudest(look: Look, others: Sequence[int]) -> Measured:
            return self._loudest_empty(k, look, others, signatures.power_at(look.nu))

        others = references(self._range_cells) if self._processing.by_range else ()
        rows = receive(looks, received, exact, self._receiver.range_cell_km, loudest, others)
        self._prepared = {}
        return rows

    def _disturbance(self, place: Place, k: int) -> Complexes:
        if self._recording is None:
            return super()._disturbance(place, k)
        return self._recording.at(k, place[1] - self._range_cells.start, len(self._range_cells))

    def _received(
        self, k: int, range_cell: int, echoes: Echoes, interference: Sequence[Add], signatures: Signatures
    ) -> Complexes:
        """Data set Y of a range cell, (n_tx n_rx,) complex."""
        y = self._met((_ALL_BINS, range_cell), k)
        for nu, alpha in echoes.get(range_cell, ()):
            add_echo(y, alpha, *signatures.at(nu))
        for add in interference:
            add(y.reshape(self._array.n_tx, self._array.n_rx), range_cell)
        return y

    def _echoes(self, k: int) -> Echoes:
        """Echoes of the targets that are there."""
        nus, alphas, width = spatial_frequency(self.measured_states), self._amplitudes(k), self._receiver.range_cell_km
        alphas *= power(np.sqrt(1.0 - 4.0 * nus**2), self._pattern_exponent)
        echoes: dict[int, list[tuple[float, complex]]] = {}
        ranges_km = self.range_km.tolist()
        for m in np.flatnonzero(self.present).tolist():
            for range_cell, share in _straddled(ranges_km[m], width):
                echoes.setdefault(range_cell, []).append((float(nus[m]), share * complex(alphas[m])))
        return echoes


def _straddled(range_km: float, width_km: float) -> list[tuple[int, float]]:
    """Range cells in which a target is received, and the factor of its amplitude in each: sinc of a matched filter.

    In the middle of a cell all of it is there; at an edge both cells have 2/pi, -3.9 dB.
    """
    if width_km == 0.0:
        return [(NO_RANGE, 1.0)]
    place = range_km / width_km - 0.5
    nearer = int(np.floor(place))
    return [(i, float(np.sinc(place - i))) for i in (nearer, nearer + 1) if i >= 0]
