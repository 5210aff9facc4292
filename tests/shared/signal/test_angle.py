"""The angle bin of one position inside a kernel, against the vector form."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from cogradar.shared.signal.angle import bin_of
from cogradar.shared.signal.array import angle_bin, spatial_frequency


@settings(deadline=None)  # the first call compiles
@given(x=st.floats(0.0, 300.0), y=st.floats(-300.0, 300.0), n_bin=st.integers(3, 400))
def test_kernel_bins_as_the_vector_form_does(x: float, y: float, n_bin: int) -> None:
    if math.hypot(x, y) < 1e-100:  # x^2 + y^2 underflows
        return
    nu = float(spatial_frequency([x, 0.0, y, 0.0]))
    position = (nu + 0.5) * (n_bin - 1) + 0.5
    if abs(position - round(position)) > 1e-9:  # on an edge between two bins either is right
        assert bin_of(x, y, n_bin) == angle_bin(nu, n_bin)


def test_a_target_at_the_array_counts_as_boresight() -> None:
    """As for many states, where atan2(0, 0) = 0 says so."""
    assert bin_of(0.0, 0.0, 99) == 49
    assert angle_bin(spatial_frequency([0.0, 0.0, 0.0, 0.0]), 17) == bin_of(0.0, 0.0, 17) == 8
