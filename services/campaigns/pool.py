"""Where runs are played: on processes of this machine, or on any other executor of concurrent.futures."""

import multiprocessing
import os
import platform
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Protocol

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import in_memory
from cogradar.services.recorder.store.tables import Recording
from cogradar.services.runs import in_process
from cogradar.shared.protocol.build import build, difference
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.plugins.sources import allow, allowance


class Pool(Protocol):
    """Opens executors; one that breaks is opened again."""

    def open(self, n_run: int) -> AbstractContextManager[Executor]:
        """An executor for so many runs; when it is left, whatever the reason, nothing of them goes on for long.

        It raises BrokenExecutor if a worker died and took its runs along.
        """


def n_core() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def interrupts_ignored() -> Iterator[None]:
    """While runs are submitted, as workers inherit it: a Ctrl-C is for this process to handle."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _Parent(Protocol):
    """The end of a pipe, whose class depends on the platform."""

    def poll(self, timeout: float | None) -> bool:
        """Wait until something comes, or until the other end is closed."""


class LocalPool:
    """Processes of this machine."""

    def __init__(self, workers: int) -> None:
        self._workers = workers

    @contextmanager
    def open(self, n_run: int) -> Iterator[Executor]:
        """Worker processes, which end at once when this is left or this process dies."""
        context = multiprocessing.get_context("spawn")
        theirs, ours = context.Pipe(duplex=False)
        n_worker = min(self._workers, n_run)
        pool = ProcessPoolExecutor(n_worker, context, initializer=_begin, initargs=(theirs, allowance()))
        try:
            yield pool
        finally:
            ours.close()  # ends the workers, and so would the death of this process
            theirs.close()
            pool.shutdown(cancel_futures=True)


def _begin(parent: _Parent, allowed: str) -> None:
    """Be a worker: it may load what its parent may."""
    allow(allowed)
    _end_with(parent)


def _end_with(parent: _Parent) -> None:
    """End this worker, in the middle of a run if need be, as soon as the other end of the pipe is closed."""

    def watch() -> None:
        with suppress(OSError):  # on Windows, where it was closed before
            parent.poll(None)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def play_one(start: RunStart, asked: str) -> tuple[Recording, float]:
    """Play a run in this worker: what is kept of it, and its CPU seconds. `asked` is the `build` that is to play it.

    A run that fails is a result as well: it would fail again.
    """
    if build() != asked:
        raise RunFailed(f"{platform.node()} {difference(build(), asked)}, so it was not used")
    began = time.process_time()
    store = in_memory()
    try:
        in_process.play(start, store=store)
    except BadInput as error:
        raise RunFailed(f"{platform.node()}: {error}") from None
    except RunFailed as error:
        if not store.read("SELECT 1 FROM run WHERE status = 'failed'"):
            raise RunFailed(f"{start.run}: {error}") from None
    recording = take(store, start.run)
    if recording is None:
        raise RunFailed(f"{start.run}: nothing was recorded")
    return recording, time.process_time() - began
