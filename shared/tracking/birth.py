"""A track that begins with one detection of the search: its target was not announced."""

import numpy as np

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.signal.looks import n_range_cells
from cogradar.shared.tracking.belief.likelihood import found_look
from cogradar.shared.tracking.belief.recovery import remembered_hit
from cogradar.shared.tracking.filters import filter_of
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.sensor import MAX_AMPLITUDE, Floats


def born(model: TrackerModel, target: int, k: int, detection: Floats) -> TrackState:
    """A tentative track after dwell k.

    detection : (8,) nu, limit, range km, nu_hat, nu_sigma, |alpha_hat|, sigma_hat, ||v||^2, as of a scan's row
    """
    nu, limit, range_km, nu_hat, nu_sigma, amplitude, sigma_hat, power = detection.tolist()
    r = min(amplitude / sigma_hat, MAX_AMPLITUDE)
    hit = found_look(model.response, nu, sigma_hat, limit, r, (nu_hat, nu_sigma, range_km))
    own = np.ones(1, dtype=np.bool_)
    echo = model.sensor.law.first_echo(np.array([amplitude + 0j]), hit.sigma, own, model.least_echo)
    n_cell = n_range_cells(*model.acquisition.ranges_km, model.response.range_cell_km)
    existence = model.existence.at_birth(limit, r, n_cell)
    rng = generator(model.seed, Purpose.INITIATION, target, k)
    return TrackState(
        target=target,
        k=k,
        belief=filter_of(model).born(model.of_echo(echo), hit, rng),
        detected=True,
        depleted=False,
        sigma_hat=sigma_hat,
        in_beam=True,
        level=sigma_hat**2 * power,
        power=power,
        echo=echo,
        modes=model.modes,
        **remembered_hit(hit),
        existence=existence,
        confirmed=model.existence.is_confirmed(existence),
    )
