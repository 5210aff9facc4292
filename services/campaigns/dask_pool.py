"""Workers of a Dask cluster: the same runs, bit for bit, on more machines.

A worker is let play if it runs this very program and a short run comes to the same digest there as here, which also
compiles its kernels. A worker that joins later is at least asked for its program with every run (`play_one`).
"""

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from distributed import Client, KilledWorker

from cogradar.services.campaigns.pool import play_one
from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.kernels import compile_all
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.messages import RunStart

CONNECT_WITHIN_S = 5.0
CHECK_WITHIN_S = 300.0  # of all workers; to compile kernels takes a minute or two
TRIAL_DWELLS = 2
POLL_S = 0.1


class DaskPool:
    """The workers behind a scheduler."""

    def __init__(self, client: Client) -> None:
        self._client = client

    @contextmanager
    def open(self, n_run: int) -> Iterator[Executor]:  # noqa: ARG002 - the cluster has the workers that it has
        """An executor; what it has not begun when it is left is cancelled, what it has begun is not waited for."""
        executor = self._client.get_executor(pure=False)
        try:
            yield executor
        except KilledWorker as error:  # a run that several workers died of
            raise BrokenExecutor(str(error)) from None
        except CancelledError:
            raise RunFailed("the Dask scheduler is gone; go on with --resume") from None
        finally:
            executor.shutdown(wait=False)


@contextmanager
def cluster(
    address: str, trial: RunStart, *, notify: Callable[[str], None], check: Callable[[], None]
) -> Iterator[DaskPool]:
    """The pool behind the scheduler at `address`, whose workers have all played `trial`, or its first dwells.

    Raises RunFailed if no scheduler answers or there is no worker, BadInput with a line for every unfit worker.
    """
    try:
        client = Client(address, timeout=CONNECT_WITHIN_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())
        raise RunFailed(f"no Dask scheduler at {address} within {CONNECT_WITHIN_S:g} s: {why}") from None
    try:
        workers: dict[str, dict[str, Any]] = client.scheduler_info(n_workers=-1)["workers"]
        if not workers:
            raise RunFailed(f"the Dask scheduler at {address} has no workers; start some: dask worker {address}")
        notify(f"checking the {len(workers)} workers of {address}")
        if faults := _faults(client, workers, trial.model_copy(update={"dwells": TRIAL_DWELLS}), check):
            raise BadInput("\n".join(faults))
        yield DaskPool(client)
    finally:
        client.close()


def trial_digest(trial: RunStart) -> str:
    """On a worker: the digest to which a run comes there. Its kernels are compiled then."""
    compile_all(lambda _: None)
    recording, _ = play_one(trial, build())
    return str(recording.run["digest"])


def _faults(
    client: Client, workers: dict[str, dict[str, Any]], trial: RunStart, check: Callable[[], None]
) -> list[str]:
    """What is wrong with each worker that is not fit."""
    names = {address: f"worker {address} ({worker['name']})" for address, worker in workers.items()}
    faults = [
        f"{names[address]}: makes {worker['nthreads']} runs in one process; start it with --nthreads 1"
        for address, worker in workers.items()
        if worker["nthreads"] != 1
    ]
    trials = _Trials(client, names, check, time.monotonic() + CHECK_WITHIN_S)
    version = "has another version of the program, of its libraries or of Python"
    differs = trials.differing(names, partial(build), build(), version)
    if faults or differs:
        return faults + differs
    other = "comes to another digest than this machine: another kind of processor?"
    first = {worker["host"]: address for address, worker in workers.items()}  # of each host: it compiles for the others
    rounds = [first.values(), workers.keys() - set(first.values())]
    expected = trial_digest(trial)
    return [
        fault
        for addresses in rounds
        for fault in trials.differing(addresses, partial(trial_digest, trial), expected, other)
    ]


@dataclass(frozen=True)
class _Trials:
    """Asks workers for what they should all come to."""

    client: Client
    names: dict[str, str]  # of workers, by address
    check: Callable[[], None]
    until: float

    def differing(self, addresses: Iterable[str], function: Callable[[], str], expected: str, fault: str) -> list[str]:
        """A line for each of these workers on which a function comes to something else, or to nothing in time."""
        alone = {"allow_other_workers": False, "pure": False}
        asked = {address: self.client.submit(function, workers=[address], **alone) for address in addresses}
        while not all(future.done() for future in asked.values()) and time.monotonic() < self.until:
            self.check()
            time.sleep(POLL_S)
        lines = []
        for address, future in asked.items():
            name = self.names[address]
            if not future.done():
                lines.append(f"{name}: no answer within {CHECK_WITHIN_S:g} s")
            elif (error := future.exception()) is not None:
                why = " ".join(str(error).split())[:200]
                lines.append(f"{name}: cannot make runs: {type(error).__name__}: {why}")
            elif future.result() != expected:
                lines.append(f"{name}: {fault}")
        return lines
