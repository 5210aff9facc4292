"""The world of independent cells: each look has a disturbance of its own, and hears only the targets in its main lobe.

What is simplified: each cell is a resolution cell with one echo of its own, y = sum_j alpha_j v(nu_j) + c with a fresh
disturbance c per bin, range cell and dwell. With bins a target echoes in its own bin only, from the bin's centre:
nothing leaks into other bins, and nothing is lost by straddling two. With steered cells it echoes from where it is,
nu_j, in every cell in whose main lobe it is, |nu_j - nu_c| < 1/n_rx, and in its own range cell. Sidelobes, and the
grating image beyond nu = +-0.5, are not modelled. Of range cells only those with a target in the main lobe are
computed; of the others the largest statistic is drawn from its distribution.
"""

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency
from cogradar.shared.signal.detector.data_set import DataSet
from cogradar.shared.signal.looks import NO_RANGE, Look, Measured, range_cell_centre, reported
from cogradar.shared.signal.waveform import Signatures
from cogradar.shared.world.scene import Scene, add_echo


class _Echo(NamedTuple):
    """What the targets of one direction and range cell send back."""

    nu: float
    range_cell: int
    alpha: complex


class CellScene(Scene):
    """A scene in which cells know nothing of each other."""

    def __init__(self, world: WorldConfig, radar: RadarConfig, seed: int, t: int) -> None:
        """The scene at clock t."""
        super().__init__(world, radar, seed, t)
        # How far off its direction a cell hears an echo; on the grid the next one is a whole bin away.
        self._reach = 0.5 / (radar.array.n_bin - 1) if self._is_on_grid else 1.0 / radar.array.n_rx

    def observe(
        self, k: int, isotropic: float, factor: NDArray[np.complex128], looks: Sequence[Look]
    ) -> list[Measured]:
        echoes, self.drawn = self._echoes(k), []
        nus = [echo.nu for echo in echoes]
        self._work_out_levels(looks)
        signatures = Signatures(isotropic, factor, self._array.n_rx)
        signatures.prepare([look.nu for look in looks])
        if not self._is_on_grid:
            signatures.prepare(nus)
        measured = list[Measured]()
        for look in looks:
            near = slice(*(bisect_left(nus, look.nu + off) for off in (-self._reach, self._reach)))
            heard = [echo for echo in echoes[near] if abs(echo.nu - look.nu) < self._reach]
            measured += self._measured(k, look, heard, signatures)
        self._prepared = {}
        return reported(measured)

    def _measured(self, k: int, look: Look, heard: Sequence[_Echo], signatures: Signatures) -> list[Measured]:
        """The cells of a look: those with a target of those that it hears, and the loudest of the others."""
        occupied = sorted({echo.range_cell for echo in heard if echo.range_cell in look.cells})
        measured = list[Measured]()
        for cell in occupied if look.cells else [NO_RANGE]:
            y = self._met((look.bin, cell), k)
            for echo in heard:
                if echo.range_cell == cell:
                    add_echo(y, echo.alpha, *signatures.at(echo.nu))
            range_km = range_cell_centre(cell, self._receiver.range_cell_km) if look.cells else 0.0
            measured.append(DataSet(y, signatures, self._processing).measure(look, range_km))
        if len(look.cells) > len(occupied):
            measured.append(self._loudest_empty(k, look, occupied, signatures.power_at(look.nu)))
        return measured

    def _echoes(self, k: int) -> list[_Echo]:
        """Echoes of the targets that are there, by direction; in one direction and range cell they add up."""
        nus, width = spatial_frequency(self.measured_states), self._receiver.range_cell_km
        if self._is_on_grid:
            nus = bin_centres(self._array.n_bin)[angle_bin(nus, self._array.n_bin)]
        cells = np.floor(self.range_km / width).astype(np.int64) if width > 0.0 else np.full(nus.size, NO_RANGE)
        alphas = self._amplitudes(k)
        echoes: dict[tuple[float, int], complex] = {}
        for m in np.flatnonzero(self.present).tolist():
            where = float(nus[m]), int(cells[m])
            echoes[where] = echoes.get(where, 0j) + complex(alphas[m])
        return [_Echo(*where, echoes[where]) for where in sorted(echoes)]
