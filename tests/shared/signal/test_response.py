"""What a look hears at the ends of the field of view, where the array cannot tell one end from the other."""

import numpy as np
import pytest

from cogradar.shared.signal.array import bin_centres, steering_vector
from cogradar.shared.signal.response import BinResponse, LobeResponse

CENTRES, ANY_RANGE = bin_centres(16), np.zeros(16)


def test_bins_at_both_ends_are_one_echo_and_no_others() -> None:
    response = BinResponse(16)
    for i, nu in enumerate(CENTRES.tolist()):
        alike = np.flatnonzero(response.is_one_echo(CENTRES, ANY_RANGE, (nu, 0.0)))
        assert alike.tolist() == ([0, 15] if i in {0, 15} else [i])


def test_looks_at_both_ends_are_beside_each_other() -> None:
    """Within 1.5 lobes of 1/16; the bins are 1/15 apart."""
    response = LobeResponse(16, 16, 16, np.inf)
    alike = np.flatnonzero(response.is_one_echo(CENTRES, ANY_RANGE, (-0.5, 0.0)))
    assert alike.tolist() == [0, 1, 14, 15]


@pytest.mark.parametrize("nu", [0.49, 0.46, -0.47])
def test_a_look_at_an_end_hears_a_target_at_the_other_as_the_array_does(nu: float) -> None:
    response = LobeResponse(16, 16, 16, np.inf)
    for nu_c in (-0.5, -0.49, 0.48, 0.5):
        heard = abs(np.vdot(steering_vector(nu_c, 16), steering_vector(nu, 16)) / 16) ** 2
        d = min(abs(nu - nu_c), 1.0 - abs(nu - nu_c))
        assert response.loss(nu - nu_c) == pytest.approx(heard if d < 1 / 16 else 0.0, rel=1e-9)
