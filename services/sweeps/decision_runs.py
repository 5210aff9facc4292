"""The runs that compare the rules of looking: played on a pool, and kept in a file of JSON lines, a run a line.

The file is small enough to be kept beside the page that is made from it: a comparison of some hours goes on where it
was, on any machine, and who doubts a line plays that run. Lines of another program are good as long as this program
comes to the same digests; of each such program some are played again before anything is added.
"""

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from services.analysis.report import LAST, sample_of
from services.analysis.stored_run import StoredRun
from services.campaigns.campaign import POLL_S
from services.campaigns.pool import Pool, interrupts_ignored
from services.errors import BadInput, RunFailed, check_stop
from services.metrics.answers import answer
from services.metrics.experiments import experiments
from services.metrics.selection import Selection
from services.metrics.store import in_memory
from services.recorder.lock import JournalLock
from services.runs import in_process
from services.sweeps.beliefs import look_into
from services.sweeps.decisions import STRATEGY, Asked, Plan, Result
from shared.protocol.build import build

DECIMALS = 6  # of shares: of 300 dwells
REPLAYED = 5  # runs of another program that must come to their digests again, of each
Report = Callable[[str], None]


def play_one(plan: Plan, asked: Asked) -> Result:
    """Play a run. One that fails is a result as well: it would fail again."""
    start, store = plan.start(asked), in_memory()
    result = Result(
        scenario=plan.scenario,
        dwells=start.dwells,
        **asked.setting._asdict(),
        rule=asked.rule,
        seed=asked.seed,
        program=build(),
    )
    try:
        in_process.play(start, store=store)
    except RunFailed as error:
        return result.model_copy(update={"failed": str(error)})
    (experiment,) = experiments(store, Selection.of({"run": start.run}))
    sample = sample_of(store, experiment, STRATEGY)
    every, last = sample.window(1, start.dwells), sample.window(max(1, start.dwells - LAST + 1), start.dwells)
    stored = StoredRun(partial(answer, store), start.run)
    return result.model_copy(
        update={
            "digest": stored.row["digest"],
            "p_d": every[0, :, 0].round(DECIMALS).tolist(),
            "p_d_last": last[0, :, 0].round(DECIMALS).tolist(),
            "lost": [None if np.isnan(lost) else int(lost) for lost in sample.is_lost()[0]],
            "decisions": look_into(stored) if plan.is_looked_into(asked) else None,
        }
    )


def play(plan: Plan, file: Path, pool: Pool, *, report: Report, stop: threading.Event) -> list[Result]:
    """The results of all runs: those that the file has, and the others, played now.

    Raises BadInput if the file is in use, or has what this plan and program cannot go on with; RunFailed, Interrupted.
    """
    with _writer(file) as add:
        _check(plan, file, pool, report=report, stop=stop)
        asked, there = plan.asked(), {result.asked: result for result in read(file)}
        missing = [one for one in asked if not _is_done(plan, one, there.get(one))]
        for n, result in enumerate(_played(plan, missing, pool, stop), len(asked) - len(missing) + 1):
            add(result)
            report(f"{n} of {len(asked)} runs")
    return read(file)


def _is_done(plan: Plan, asked: Asked, result: Result | None) -> bool:
    """Whether a run was played, and looked into if it is to be."""
    if result is None or result.failed is not None:
        return result is not None
    return result.decisions is not None or not plan.is_looked_into(asked)


def _played(plan: Plan, asked: list[Asked], pool: Pool, stop: threading.Event) -> Iterator[Result]:
    """Results of runs as they come. Raises RunFailed if a worker dies, Interrupted."""
    if not asked:
        return
    try:
        with pool.open(len(asked)) as executor:
            with interrupts_ignored():
                waiting = {executor.submit(play_one, plan, one) for one in asked}
            while waiting:
                done, waiting = wait(waiting, timeout=POLL_S, return_when=FIRST_COMPLETED)
                check_stop(stop, "; the same command goes on")
                for future in done:
                    yield future.result()
    except BrokenExecutor:
        raise RunFailed("a worker process died (out of memory?); the same command goes on") from None


def _check(plan: Plan, file: Path, pool: Pool, *, report: Report, stop: threading.Event) -> None:
    """Raises BadInput if results are of another scenario, or of a program that comes to other digests than this one."""
    results, dwells = read(file), plan.start(plan.asked()[0]).dwells
    for result in results:
        if (result.scenario, result.dwells) != (plan.scenario, dwells):
            held = f"runs of {result.scenario}, {result.dwells} dwells"
            raise BadInput(f"{file}: holds {held}, not of {plan.scenario}, {dwells} dwells; name another file")
    others: dict[str, list[Result]] = {}
    for result in results:
        if result.program != build() and result.failed is None:
            others.setdefault(result.program, []).append(result)
    # The first ones of each: seeds that every later call finds again.
    again = {result.asked: result for mine in others.values() for result in mine[:REPLAYED]}
    if again:
        report(f"playing {len(again)} runs of other versions of the program again")
    for result in _played(plan._replace(belief_runs=0), list(again), pool, stop):
        there = again[result.asked]
        if result.digest != there.digest:
            raise BadInput(
                f"{file}: program {there.program} played rule {result.rule}, seed {result.seed} otherwise than this one"
                f" ({there.digest} there, {result.digest} now); name another file"
            )


@contextmanager
def _writer(file: Path) -> Iterator[Callable[[Result], None]]:
    """Adds results to a file, which nobody else does meanwhile. Raises BadInput."""
    lock = JournalLock(str(file), "cogradar decisions")
    try:
        _drop_torn(file)
        with file.open("a", encoding="utf-8") as lines:

            def add(result: Result) -> None:
                lines.write(result.model_dump_json(exclude_none=True) + "\n")
                lines.flush()

            yield add
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror}") from None
    finally:
        lock.release()


def _drop_torn(file: Path) -> None:
    """Remove the line that was being written when a process was killed."""
    if file.exists():
        text = file.read_bytes()
        os.truncate(file, text.rfind(b"\n") + 1)


def read(file: Path) -> list[Result]:
    """The results in a file, the newest of each run; none if it is not there. Raises BadInput."""
    try:
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        raise BadInput(f"{file}: {error}") from None
    found: dict[Asked, Result] = {}
    for number, line in enumerate(lines, 1):
        if not line.endswith("\n"):
            break  # somebody is writing it, or was killed
        try:
            result = Result.model_validate_json(line)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise BadInput(f"{file}, line {number}: {where or 'no result'}: {first['msg']}") from None
        found[result.asked] = result
    return list(found.values())
