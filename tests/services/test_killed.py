"""SIGKILL at random moments of a recorder and of an export: each goes on from what it left behind.

COGRADAR_KILLS says how many kills there are of each in the nightly tests.
"""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from cogradar.services.analysis.export import formats
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import Checkpoint, Message
from cogradar.shared.wire.codec import decode, encode
from tests.services.loop import play as play_cores
from tests.services.loop import smoke_start
from tests.services.stored import result as result_of

KILLS = int(os.environ.get("COGRADAR_KILLS", "200"))
FEW = 6
MANY = pytest.param(KILLS, marks=pytest.mark.nightly)
START = smoke_start(dwells=40)
CONTEXT = multiprocessing.get_context("forkserver")  # a process that has loaded this module has children in no time


@pytest.fixture(scope="module", autouse=True)
def _preloaded() -> None:
    CONTEXT.set_forkserver_preload(["tests.services.test_killed"])


def _begun(target: Callable[..., None], *arguments: object) -> tuple[BaseProcess, Connection]:
    """A process that has told that it begins, and what it tells from then on."""
    ours, theirs = CONTEXT.Pipe(duplex=False)
    process = CONTEXT.Process(target=target, args=(theirs, *arguments))
    process.start()
    theirs.close()
    ours.recv()
    return process, ours


def _all(told: Connection) -> Iterator[int]:
    """What was told before the end."""
    try:
        while True:
            yield told.recv()
    except EOFError:
        told.close()


def _took_s(target: Callable[..., None], *arguments: object) -> float:
    """How long a process takes that nobody kills."""
    process, told = _begun(target, *arguments)
    began = time.monotonic()
    process.join()
    told.close()
    assert process.exitcode == 0
    return time.monotonic() - began


def _killed(process: BaseProcess, after_s: float) -> bool:
    """Kill a process so long after it began; whether it was in time."""
    process.join(after_s)
    process.kill()
    process.join()
    return process.exitcode == -signal.SIGKILL


# The recorder.


def _record(told: Connection, path: str, payloads: list[bytes]) -> None:
    """Record a run, or go on; tells how many dwells each checkpoint acknowledges."""
    core = Recorder(Journal(path), resume=True)
    told.send(0)
    for payload in payloads:
        for said in core.handle(decode(payload)):
            if isinstance(said, Checkpoint):
                told.send(said.k)
    core.close()


@pytest.mark.parametrize("kills", [FEW, MANY])
def test_of_a_recorder_nothing_is_lost_that_was_acknowledged(kills: int, tmp_path: Path) -> None:
    """It is killed and resumed until the run is over, and again with the next; all have the digest of one process."""
    messages: list[Message] = play_cores(START)
    payloads = [encode(message) for message in messages if not isinstance(message, Checkpoint)]
    expected = in_process.play(START).run["digest"]
    whole_s = _took_s(_record, str(tmp_path / "whole.db"), payloads)
    rng, done, tries = generator(1, Purpose.FAULT, 0, 0), 0, 0
    while done < kills:
        path, tries = tmp_path / f"{tries}.db", tries + 1
        is_over = False
        while not is_over:
            process, told = _begun(_record, str(path), payloads)
            was_killed = _killed(process, rng.uniform(0.0, whole_s) if done < kills else 1e3 * whole_s)
            acknowledged = max(_all(told), default=0)
            done += was_killed
            journal = Journal(str(path), read_only=True)
            rows = journal.read("SELECT acknowledged_k AS k, status, digest FROM run")
            assert (rows[0]["k"] if rows else 0) >= acknowledged
            is_over = bool(rows) and rows[0]["status"] == "complete"
            assert not is_over or rows[0]["digest"] == expected
            journal.close()
    assert done >= kills


# An export.


def _export(told: Connection, path: str, out: str, form: str) -> None:
    result = result_of(path)
    told.send(0)
    formats.write(result, Path(out), form, force=True)


@pytest.mark.parametrize("kills", [FEW, MANY])
def test_of_an_export_the_file_is_whole_or_the_one_before(kills: int, tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    store = Store(Journal(path))
    in_process.play(START, store=store)
    store.close()
    forms = ("csv", "json", "npz", "parquet")[: kills // 3]
    wholes, took_s = {}, {}
    for form in forms:
        out = tmp_path / f"whole.{form}"
        took_s[form] = _took_s(_export, path, str(out), form)
        wholes[form] = out.read_bytes()
    rng, done, found = generator(2, Purpose.FAULT, 0, 0), 0, set[bytes]()
    while done < kills:
        form = forms[int(rng.integers(len(forms)))]
        before = b"an older one" if rng.random() < 0.5 else None
        out = tmp_path / f"run.{form}"
        out.unlink(missing_ok=True)
        if before is not None:
            out.write_bytes(before)
        process, told = _begun(_export, path, str(out), form)
        done += _killed(process, rng.uniform(0.0, took_s[form]))
        told.close()
        now = out.read_bytes() if out.exists() else None
        assert now in {before, wholes[form]}
        formats.write(result_of(path), out, form, force=True)
        assert out.read_bytes() == wholes[form]
        found.add(now or b"")
    assert len(found) > 1
