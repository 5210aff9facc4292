"""Three processes of one kind, or of one name, that start at once, again and again: exactly one of them lives."""

import multiprocessing
import threading
import time
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Any

import pytest

from cogradar.services import kernels, process
from cogradar.services.errors import BadInput
from cogradar.services.topology import Start
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.topics import Role

STARTS, APART_S = 50, 0.2  # and by how much at most they begin apart
WITHIN_S, WAIT_S = 1.0, 60.0
OVER = "over"  # a file; what processes share would wait for those that have ended

pytestmark = [pytest.mark.zenoh, pytest.mark.nightly]


def _live(role: Role, name: str, i: int, router: str, folder: str, after_s: float, at_once: Any, said: Any) -> None:
    """Be a process, of recorders with a journal of its own, whose lock would else tell who is there, and say what came
    of it.
    """
    stop = threading.Event()

    def end() -> None:
        while not (Path(folder) / OVER).exists():
            time.sleep(0.05)
        stop.set()

    threading.Thread(target=end, daemon=True).start()
    process.HOLDER_WITHIN_S = WITHIN_S
    at_once.wait()
    time.sleep(after_s)
    try:
        process.be(role, Start(name, f"{folder}/{i}.db", http="off"), connect=router, listen="", stop=stop)
    except BadInput as refused:
        said.put((i, str(refused)))
    else:
        said.put((i, ""))


@pytest.fixture(scope="module")
def processes() -> ForkServerContext:
    """Processes that have imported everything when they begin."""
    context = multiprocessing.get_context("forkserver")
    modules = ["process", "recorder.full_disk", "planner.core"]
    context.set_forkserver_preload([*(f"cogradar.services.{module}" for module in modules), __name__])
    return context


@pytest.mark.parametrize(("role", "names"), [(Role.RECORDER, "abc"), (Role.PLANNER, "aaa")])
def test_of_three_that_start_at_once_one_lives(
    role: Role, names: str, router: str, processes: ForkServerContext, tmp_path: Path
) -> None:
    kernels.compile_all(lambda _: None)
    rng = generator(1, Purpose.FAULT, 0, 0)
    for n in range(STARTS):
        at_once, said = processes.Barrier(3), processes.Queue()
        folder = tmp_path / str(n)
        folder.mkdir()
        started = []
        for i, name in enumerate(names):
            args = (role, name, i, router, str(folder), float(rng.random()) * APART_S, at_once, said)
            started.append(processes.Process(target=_live, args=args))
            started[-1].start()
        refused = dict(said.get(timeout=WAIT_S) for _ in range(2))
        assert all(f"another {role} is there already" in text for text in refused.values()), (n, refused)
        (left,) = {0, 1, 2} - refused.keys()
        assert all(names[left] in text.partition("already")[2] for text in refused.values()), (n, refused)
        (folder / OVER).touch()
        assert said.get(timeout=WAIT_S) == (left, ""), n
        for one in started:
            one.join(WAIT_S)
