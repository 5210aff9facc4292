from collections.abc import Callable

import pytest

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd


@pytest.fixture
def simulated() -> Callable[[], EmulatorCore]:
    """Makes emulators that simulate."""
    return lambda: EmulatorCore(SimulatedFrontEnd.open)
