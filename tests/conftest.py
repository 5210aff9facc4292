"""What all tests share. `shared` is imported before NumPy: it sets the number of linear-algebra threads."""

import gc
import os
import threading
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import settings

# Kernels of the tests stay out of the user's cache.
os.environ["COGRADAR_CACHE_DIR"] = str(Path(__file__).parent.parent / "build" / "test-kernels")

import_module("cogradar")

# All tests and what they import live as long as the process: a sixth of its time went into looking through them for
# objects that nothing reaches. They are not frozen, for Hypothesis looks through them, too.
gc.set_threshold(import_module("cogradar.__main__").NEW_OBJECTS)

# The first example of a property may compile a kernel.
settings.register_profile("cogradar", deadline=None)
settings.load_profile("cogradar")


@pytest.fixture
def router() -> Iterator[str]:
    """A router behind which there is nobody."""
    session = import_module("cogradar.shared.wire.session")  # after the settings above

    stop, endpoint = threading.Event(), f"tcp/127.0.0.1:{session.free_port()}"
    thread = threading.Thread(target=session.run_router, args=(endpoint, stop))
    thread.start()
    yield endpoint
    stop.set()
    thread.join()


def pytest_addoption(parser: pytest.Parser) -> None:
    """How long the page is left open in its test of memory, and how many messages are sent with something wrong."""
    parser.addoption("--browser-minutes", type=int, default=10, help="minutes of the page's test of memory")
    parser.addoption("--mutants", type=int, default=1_000_000, help="nightly mutants of each topic at each reader")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests first, or all but one process wait for them at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
