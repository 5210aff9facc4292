"""From when on a target counts: since the dwell in which a look with all power would have found it.

By P_D in the limit of many channels, which costs nothing in each dwell. Where it is one half, it is .45 to .55 of 10^4
channels; of 256, .3 to .7.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.signal.looks import range_cells
from cogradar.shared.signal.receiver import detection_probability, noncentrality, threshold
from cogradar.shared.signal.response import Response
from cogradar.shared.tracking.existence import alert_p_fa
from cogradar.shared.world.disturbance import power_spectrum

FOUND = 0.5  # with this probability
_STRONGEST = 1e9  # zeta of an echo that is found under any law and limit


class Detectability(NamedTuple):
    """What a look with all power finds."""

    signature_power: float  # ||v||^2 with all power on the target: P n_tx n_rx
    needed: NDArray[np.float64]  # (n_target,) zeta at which P_D is one half, by the law of each target's echoes
    disturbance: str
    response: Response

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Of a simulated scenario, all range cells of the look being tested. ValueError without a [world]."""
        radar, world = scenario.radar, scenario.simulated
        array, prior, width = radar.array, radar.acquisition, radar.receiver.range_cell_km
        n_cell = len(range_cells(prior.range_min_km, prior.range_max_km, width)) if width else 1
        p_fa = radar.detector.p_fa
        if radar.search is not None:  # an unknown target is looked at by the search only
            p_fa = alert_p_fa(array.n_bin if radar.search.beams == "auto" else radar.search.beams)
        limit = threshold(p_fa, n_cell)
        laws = [target.rcs or world.rcs for target in world.targets]
        needed = {
            law: brentq(lambda zeta, law=law: float(detection_probability(zeta, limit, law)) - FOUND, 0.0, _STRONGEST)
            for law in set(laws)
        }
        return cls(
            array.power * array.n_tx * array.n_rx,
            np.array([needed[law] for law in laws]),
            world.disturbance.model,
            ScanRows.of(radar).response,
        )

    def finds(
        self,
        targets: NDArray[np.int64],
        states: NDArray[np.float64],
        snr_db: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Whether each target would be found: (m,) from 0, (m, 4) km and km/s, (m,) per channel -> (m,).

        states : where the array measures the targets (`array.in_plane`)
        """
        nus = self.response.echo_from(spatial_frequency(states))
        spectrum = power_spectrum(self.disturbance, nus)
        zeta = noncentrality(10.0 ** (snr_db / 10.0), self.signature_power, spectrum)
        return np.asarray(zeta >= self.needed[targets])
