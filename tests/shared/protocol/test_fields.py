"""Questions to arrays: the answers of NumPy's own reductions."""

import numpy as np
import pytest

from cogradar.shared.protocol.fields import are_among, is_all, is_any

CONDITIONS = [np.array(values, np.bool_) for values in ([], [0], [1], [0, 1], [1, 1], [[0, 0], [0, 1]], [[1], [1]])]


@pytest.mark.parametrize("condition", CONDITIONS)
def test_any_and_all(condition: np.ndarray) -> None:
    assert is_any(condition) is bool(condition.any())
    assert is_all(condition) is bool(condition.all())


@pytest.mark.parametrize("values", [[], [1.0], [-0.0, 2.0], [3.0], [np.nan], [[1.0, 2.0], [2.0, 0.0]]])
def test_values_among_others(values: list[float]) -> None:
    others = np.array([[0.0, 1.0], [2.0, np.nan]])
    assert are_among(np.array(values), others) is bool(np.isin(values, others).all())
