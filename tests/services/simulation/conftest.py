from collections.abc import Iterator

import pytest

from cogradar.services.simulation import trials
from cogradar.services.simulation.memory import remembering


@pytest.fixture(scope="module")
def remembered() -> Iterator[None]:
    """The results of the slowest functions, through all schedules of a module."""
    with remembering(trials.REMEMBERED):
        yield
