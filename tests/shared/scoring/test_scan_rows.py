"""What a scan says of many targets is what its rows, all of them, say of each."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.array import apart, spatial_frequency
from cogradar.shared.signal.response import BinResponse, LobeResponse, Response
from cogradar.shared.signal.scan import Detections

N_TARGET, N_LOOK = 80, 90


def scan_of(response: Response, rng: np.random.Generator) -> tuple[Detections, NDArray[np.float64]]:
    """Rows about targets at random, of which some are at the ends; each target has a track."""
    sines, ranges_km = rng.uniform(-1.0, 1.0, N_TARGET), rng.uniform(5.0, 9.0, N_TARGET)
    sines[:4] = -1.0, 1.0, -0.999, 0.999
    x, y = ranges_km * np.sqrt(1.0 - sines**2), ranges_km * sines
    states = np.column_stack((x, np.zeros(N_TARGET), y, np.zeros(N_TARGET)))
    of = rng.integers(N_TARGET, size=N_LOOK)
    nus = np.sort(response.echo_from(np.clip(0.5 * sines[of] + rng.normal(0.0, 5e-3, N_LOOK), -0.5, 0.5)))
    zeros = np.zeros(N_LOOK)
    beam_nus = np.column_stack((0.5 * sines, 0.5 * sines + 0.01))
    return Detections(
        k=1,
        bins=zeros.astype(np.int32),
        statistic=rng.uniform(0.0, 40.0, N_LOOK),
        alpha_hat=zeros.astype(np.complex64),
        sigma_hat=zeros,
        signature_power=rng.uniform(0.0, 100.0, N_LOOK),
        beams=np.where(rng.random((N_TARGET, 2)) < 0.5, 1, -1).astype(np.int32),
        nus=nus,
        limits=np.full(N_LOOK, 20.0),
        ranges_km=np.where(response.measures_range, rng.integers(10, 18, N_LOOK) * 0.5 + 0.25, 0.0),
        nu_hats=nus,
        nu_sigmas=zeros,
        beam_nus=beam_nus + rng.normal(0.0, 5e-3, beam_nus.shape),
        gates=np.zeros((N_TARGET, 2)),
    ), states


@pytest.mark.parametrize("response", [LobeResponse(16, 16, 16, 0.5), LobeResponse(16, 16, 2, np.inf), BinResponse(16)])
def test_what_is_seen_of_targets_is_what_all_rows_say_of_each(response: Response) -> None:
    rng = np.random.default_rng(1)
    scan, states = scan_of(response, rng)
    beams = [-1, *range(1, N_TARGET)]
    detected, power, lit = ScanRows(response, 20.0).seen(scan, states, beams)
    for m, nu in enumerate(response.echo_from(spatial_frequency(states))):
        heard = response.loss(scan.nus - nu) ** 2
        range_km = np.hypot(states[m, 0], states[m, 2])
        is_there = (heard > 0.0) & (np.abs(scan.ranges_km - range_km) <= 0.5 * response.range_cell_km)
        assert detected[m] == (is_there & (scan.statistic >= 20.0)).any()
        assert power[m] == (heard * scan.signature_power).max(initial=0.0)
        near = apart(scan.beam_nus[m], nu) <= 0.5 / 15
        assert lit[m] == (beams[m] >= 0 and (near & (scan.beams[m] >= 0)).any())
    assert detected.any()
    assert lit.any()
