"""The runs that compare the rules of looking: played on a pool, and kept in a file of JSON lines, a run a line.

The file is small enough to be kept beside the page that is made from it: a comparison of some hours goes on where it
was, on any machine, and who doubts a line plays that run. Lines of another program are good as long as this program
comes to the same; of each such program some are played again before anything is added.
"""

import hashlib
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from services.analysis import report
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
from services.sweeps import beliefs
from services.sweeps.decisions import STRATEGY, Asked, Plan, Result, Setting
from shared.protocol.build import build
from shared.scenario.tables import BIN_RULES

DECIMALS = 6  # of shares: of 300 dwells
REPLAYED = 5  # runs of another program that must come to the same again, of each
FIRST = '{"scenario":'  # how a line begins
Tell = Callable[[str], None]


@cache
def program() -> str:
    """Digest of the program that plays, and of what says what its runs came to."""
    digest = hashlib.sha256(build().encode())
    for source in (report.__file__, beliefs.__file__, __file__):
        digest.update(Path(source).read_bytes())
    return digest.hexdigest()[:16]


def play_one(plan: Plan, asked: Asked) -> Result:
    """Play a run. One that fails is a result as well: it would fail again. Raises RunFailed if it cannot be played."""
    start, store = plan.start(asked), in_memory()
    result: dict[str, Any] = {"scenario": plan.scenario, "dwells": start.dwells, **asked.setting._asdict()}
    result |= {"rule": asked.rule, "seed": asked.seed, "document": plan.document(asked), "program": program()}
    try:
        in_process.play(start, store=store)
    except RunFailed as error:
        if not store.read("SELECT 1 FROM run WHERE status = 'failed'"):
            raise RunFailed(f"{start.run}: {error}") from None
        return Result(**result, failed=str(error))
    (experiment,) = experiments(store, Selection.of({"run": start.run}))
    sample = report.sample_of(store, experiment, STRATEGY)
    first = max(1, start.dwells - report.LAST + 1)
    stored = StoredRun(partial(answer, store), start.run)
    return Result(
        **result,
        digest=stored.row["digest"],
        p_d=_numbers(sample.window(1, start.dwells)[0, :, 0]),
        p_d_last=_numbers(sample.window(first, start.dwells)[0, :, 0]),
        lost=[None if np.isnan(lost) else int(lost) for lost in sample.is_lost()[0]],
        decisions=beliefs.look_into(stored) if plan.is_looked_into(asked) else None,
    )


def _numbers(values: NDArray[np.float64]) -> list[float | None]:
    return [None if np.isnan(value) else round(float(value), DECIMALS) for value in values]


def play(plan: Plan, file: Path, pool: Pool, *, tell: Tell, stop: threading.Event) -> list[Result]:
    """The results of all runs: those that the file has, and the others, played now.

    Raises BadInput if the file is in use, or has what this plan and program cannot go on with; RunFailed, Interrupted.
    """
    lock = JournalLock(str(file), "cogradar decisions")
    try:
        there = read(file)
        _check(plan, file, there, pool, tell=tell, stop=stop)
        asked, done = plan.asked(), {result.asked for result in there if _is_done(plan, result)}
        missing = [one for one in asked if one not in done]
        with _lines(file) as add:
            for n, result in enumerate(_played(plan, missing, pool, stop), len(asked) - len(missing) + 1):
                add(result)
                tell(f"{n} of {len(asked)} runs")
    finally:
        lock.release()
    return of_plan(plan, file)


def of_plan(plan: Plan, file: Path) -> list[Result]:
    """The results in a file that belong to a plan. Raises BadInput if it has others of another scenario."""
    asked = set(plan.asked())
    found = read(file)
    _check_scenario(plan, file, found)
    return [result for result in found if result.asked in asked]


def _is_done(plan: Plan, result: Result) -> bool:
    """Whether a run need not be played: another program may fail no more, or look into more rules."""
    if result.failed is not None:
        return result.program == program()
    looked_into = result.decisions is not None and result.decisions.loss.keys() >= set(BIN_RULES)
    return looked_into or not plan.is_looked_into(result.asked)


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


def _check_scenario(plan: Plan, file: Path, results: Sequence[Result]) -> None:
    documents: dict[tuple[Setting, str], str] = {}
    dwells = plan.start(plan.asked()[0]).dwells
    for result in results:
        if (result.scenario, result.dwells) != (plan.scenario, dwells):
            held = f"runs of {result.scenario}, {result.dwells} dwells"
            raise BadInput(f"{file}: holds {held}, not of {plan.scenario}, {dwells} dwells; name another file")
        cell = result.asked.setting, result.rule
        if cell not in documents:
            documents[cell] = plan.document(result.asked)
        if documents[cell] != result.document:
            raise BadInput(f"{file}: {plan.scenario} has changed since these runs were played; name another file")


def _check(plan: Plan, file: Path, results: Sequence[Result], pool: Pool, *, tell: Tell, stop: threading.Event) -> None:
    """Raises BadInput if results are of another scenario, or of a program that comes to others than this one."""
    _check_scenario(plan, file, results)
    others: dict[str, list[Result]] = {}
    for result in sorted(results, key=lambda result: result.asked):
        if result.program != program() and result.failed is None:
            others.setdefault(result.program, []).append(result)
    again: dict[Asked, Result] = {}
    for mine in others.values():  # from all settings: evenly over them
        places = np.linspace(0, len(mine) - 1, min(REPLAYED, len(mine))).round().astype(int)
        again |= {mine[place].asked: mine[place] for place in places}
    if again:
        tell(f"playing {len(again)} runs of other versions of the program again")
    for result in _played(plan._replace(belief_runs=0), list(again), pool, stop):
        there = again[result.asked]
        if result.model_copy(update={"program": there.program, "decisions": there.decisions}) != there:
            raise BadInput(
                f"{file}: program {there.program} played rule {result.rule}, seed {result.seed} otherwise than this one"
                f" ({there.digest} there, {result.digest} now): another program, or arithmetic of another kind of"
                " processor (docs/explanation/determinism.md); name another file"
            )


@contextmanager
def _lines(file: Path) -> Iterator[Callable[[Result], None]]:
    """Adds results to a file, whose last line was not written whole if a process was killed. Raises BadInput."""
    try:
        if file.exists():
            os.truncate(file, file.read_bytes().rfind(b"\n") + 1)
        lines = file.open("a", encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror}") from None
    with lines:

        def add(result: Result) -> None:
            lines.write(result.model_dump_json(exclude_none=True) + "\n")
            lines.flush()

        yield add


def read(file: Path) -> list[Result]:
    """The results in a file, the newest of each run; none if it is not there. Raises BadInput.

    A last line that is not whole is left out: somebody is writing it, or was killed.
    """
    try:
        *lines, last = file.read_text(encoding="utf-8").split("\n")
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        raise BadInput(f"{file}: {error}") from None
    if not FIRST.startswith(last[: len(FIRST)]):
        raise BadInput(f"{file}, line {len(lines) + 1}: no result")
    found: dict[Asked, Result] = {}
    for number, line in enumerate(lines, 1):
        try:
            result = Result.model_validate_json(line)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise BadInput(f"{file}, line {number}: {where or 'no result'}: {first['msg']}") from None
        found[result.asked] = result
    return list(found.values())
