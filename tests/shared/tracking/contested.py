"""Looks of one waveform that several tracks may have, and tracks beside each other."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.response import LobeResponse
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.assignment.shares import Share, share_of
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.existence import BernoulliExistence
from cogradar.shared.tracking.model import NONE, TrackState
from tests.shared.tracking.models import smoke_model

Floats = NDArray[np.float64]

LOBE = LobeResponse(16, 16, 16, 0.5)
LIMIT, SIGMA_HAT, NU_SIGMA = 20.0, 0.1, 0.002
BEST_RANGE = smoke_model("best-range", n_particle=2000)
UNKNOWN = replace(BEST_RANGE, existence=BernoulliExistence(1.0, 10.0, BEST_RANGE.acquisition.range_max_km))
IMPOSSIBLE, EXISTENCE = -1e9, 0.99


def scan_of(
    echoes: Sequence[tuple[float, float, float]],
    expected: Sequence[tuple[float, float]],
    sigmas: tuple[float, float] = (0.002, 0.1),
    missed: Sequence[float] = (),
    k: int = 1,
) -> Detections:
    """Detections at (nu of the look, nu measured, range), and looks in vain; tracks expected at (nu, range).

    Each track has a look where it is expected, and a gate of 4 km to either side.
    """
    seen = sorted(
        [(nu, nu_hat, range_km, 1.0) for nu, nu_hat, range_km in echoes] + [(nu, nu, 49.25, 0.0) for nu in missed]
    )
    nus, nu_hats, ranges_km, hits = np.array(seen).reshape(-1, 4).T
    places = np.array(expected)
    return Detections(
        k=k,
        bins=np.floor((nus + 0.5) * 15 + 0.5).astype(np.int32),
        statistic=np.where(hits > 0.0, 200.0 + np.arange(nus.size), 1.0),
        alpha_hat=np.where(hits > 0.0, 1.0, 0.05).astype(np.complex64),
        sigma_hat=np.full(nus.size, SIGMA_HAT),
        signature_power=np.full(nus.size, 16.0),
        beams=np.floor((places[:, :1] + 0.5) * 15 + 0.5).astype(np.int32),
        nus=nus,
        limits=np.full(nus.size, LIMIT),
        ranges_km=ranges_km,
        nu_hats=nu_hats,
        nu_sigmas=np.where(hits > 0.0, NU_SIGMA, 0.0),
        beam_nus=places[:, :1].copy(),
        gates=np.floor(places[:, 1:]) + np.array([-4.0, 5.0]),
        ids=np.arange(places.shape[0], dtype=np.int32),
        expected=np.array([[nu, sigmas[0], range_km, sigmas[1], EXISTENCE] for nu, range_km in expected]),
    )


def shares(scan: Detections, response: LobeResponse = LOBE) -> list[Share]:
    return [share_of(response, scan, own) for own in range(scan.beams.shape[0])]


def placed(nu: NDArray[np.floating], range_km: NDArray[np.floating]) -> Floats:
    """(n, 2) in km."""
    return np.column_stack((range_km * np.sqrt(1.0 - 4.0 * nu**2), range_km * 2.0 * nu))


def begun(target: int, across: tuple[float, float], along: tuple[float, float] = (50.2, 0.0)) -> TrackState:
    """A track at this direction and range, each with its change per dwell."""
    rng, n = np.random.default_rng(target), BEST_RANGE.belief.n_particle
    path = placed(across[0] + across[1] * np.arange(2), along[0] + along[1] * np.arange(2))
    xy = placed(across[0] + 0.001 * rng.standard_normal(n), along[0] + 0.05 * rng.standard_normal(n))
    v = path[1] - path[0] + 0.003 * rng.standard_normal((n, 2))
    return TrackState(
        target=target,
        k=0,
        belief=Particles(np.column_stack((xy[:, 0], v[:, 0], xy[:, 1], v[:, 1]))),
        detected=True,
        depleted=False,
        sigma_hat=SIGMA_HAT,
        in_beam=True,
        level=SIGMA_HAT**2 * 16.0,
        power=16.0,
        echo=1.0,
        remembered=NONE,
        hit_bin=9,
        hit_amplitude=10.0,
        measured=np.array([across[0], across[0], NU_SIGMA, along[0]]),
        looked=np.empty((0, BEST_RANGE.response.memory_width)),
        log_evidence=0.0,
        attempts=0,
    )
