"""Compiled kernels: make them once per state of the sources, and report it."""

import logging
import os
import shutil
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from filelock import lock_descriptor

from cogradar.services.errors import RunFailed, check_stop
from cogradar.shared.numerics.jit import CACHE_DIR, CACHED, NOT_KEPT, compiling, interpret, late_kernels
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.messages import Checkpoint, RunStart
from cogradar.shared.scenario.faults import printable
from cogradar.shared.scenario.files import SCENARIO_DIR, parse
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.tables import BIN_RULES, FIDELITY

UNKNOWN_NUMBER = {"fidelity": "best-range", "tracks": "unknown"}  # its filter is of Gaussians
EACH_S = 15.0  # how far it is, is said
FUNCTIONS = 440  # some, to compile
LAST = 0.95  # of them, from which on each takes longer
MAX_USERS = 1000  # processes of one folder that are told apart
UNUSED_DAYS = 30.0  # after which kernels of other sources are removed
log = logging.getLogger(__name__)
_locks: dict[Path, int] = {}  # a descriptor per folder: open, and so locked, until this process ends


def are_compiled() -> bool:
    """Whether an earlier start compiled the kernels of exactly these sources."""
    return CACHED and (CACHE_DIR / "complete").exists()


def interpret_unless_compiled() -> None:
    """Spare a command that calls few kernels the wait for the compiler; before the first kernel is imported."""
    if not are_compiled():
        interpret()


def compile_all(report: Callable[[str], None], stop: threading.Event | None = None) -> None:
    """Compile every kernel, unless that was done, by playing a few dwells of the smoke scenario in this process.

    Raises Interrupted, within about a second, if `stop` is set meanwhile; RunFailed if the folder is full.
    """
    if NOT_KEPT:
        report(printable(f"compiled kernels cannot be kept in {NOT_KEPT}"))
    try:
        if CACHED:
            _lock()
        if not are_compiled():
            when = "for this command only" if NOT_KEPT else "once after an installation or a change of the sources"
            report(f"compiling kernels: {when}, a minute or two")
            _compile(report, stop)
        if CACHED:
            _mark()
    except OSError as error:
        raise RunFailed(printable(f"{error.filename or CACHE_DIR}: {error.strerror or error}")) from None


def load_planner() -> None:
    """Import and load what a planner's first run needs, by joining one that is thrown away: half a second of processor.

    Others leave tracks to a planner as soon as they see it, and wait for it then.
    """
    from cogradar.services.planner.core import PlannerCore

    document = tomllib.loads((SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8"))
    start = RunStart.of(parse(document, source="smoke"), Strategy.POWER_AWARE, seed=1, dwells=2)
    run: dict[str, Any] = {"run": start.run, "strategy": start.strategy, "dwells": 2, "rate_hz": 0.0}
    run |= {"radar": start.scenario["radar"], "seed": radar_seed(start.seed)}
    logging.disable(logging.INFO)  # or the log says that it owns tracks of this run
    try:
        list(PlannerCore("loads").handle(Checkpoint(**run, k=1, t=1)))
    finally:
        logging.disable(logging.NOTSET)


def _compile(report: Callable[[str], None], stop: threading.Event | None) -> None:
    from cogradar.services.planner.decision import warm_up
    from cogradar.services.runs.in_process import play
    from cogradar.shared.tracking.model import TrackerModel

    check = partial(check_stop, stop, " while compiling kernels; the next start goes on")
    document = tomllib.loads((SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8"))
    n = 0

    def begin() -> None:
        nonlocal n
        check()
        n += 1

    with (
        _said_meanwhile(lambda: report(f"compiling kernels: {n} of some {max(FUNCTIONS, n)} functions{_longer(n)}")),
        compiling(begin),
    ):
        turning = {"motion": document["radar"]["motion"] | {"modes": "mixture"}}
        joint = document["radar"] | turning | {"planner": document["radar"]["planner"] | {"looks": "joint"}}
        play(RunStart.of(parse(document | {"radar": joint}, source="smoke"), Strategy.POWER_AWARE, seed=1, dwells=2))
        receiver = {"fidelity": "best", "receiver": {"separation": "joint", "noise": "rows"}}
        of_array = {"world": document["world"] | {"signal": "array"}, "radar": document["radar"] | receiver}
        play(RunStart.of(parse(document | of_array, source="smoke"), Strategy.POWER_AWARE, seed=1, dwells=2))
        check()
        for changed in (UNKNOWN_NUMBER, *({"fidelity": fidelity} for fidelity in FIDELITY)):
            scenario = parse(document | {"radar": document["radar"] | changed}, source="smoke")
            for strategy in Strategy:
                play(RunStart.of(scenario, strategy, seed=1, dwells=2))
                check()
                # A search that may end early is compiled on its own.
                warm_up(scenario.radar, TrackerModel.of(scenario.radar, strategy, seed=1))
                check()
        for rule in BIN_RULES:
            planner = scenario.radar.planner.model_copy(update={"rule": rule})
            radar = scenario.radar.model_copy(update={"planner": planner})
            warm_up(radar, TrackerModel.of(radar, Strategy.POWER_AWARE, seed=1))
            check()


@contextmanager
def _said_meanwhile(say: Callable[[], None]) -> Iterator[None]:
    """Call this now and then, also while one long function is compiled."""
    over = threading.Event()

    def repeat() -> None:
        while not over.wait(EACH_S):
            say()

    thread = threading.Thread(target=repeat, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _longer(n: int) -> str:
    return "; the last ones take longer" if n >= LAST * FUNCTIONS else ""


def say_late() -> AbstractContextManager[None]:
    """Within, a kernel that is compiled is said in the log: `compile_all` lacks it, and all runs wait for it."""
    return late_kernels(lambda name, took_s: log.warning("all runs waited for %.1f s: %s was compiled", took_s, name))


def _mark() -> None:
    """Mark the kernels as complete and in use today; remove kernels that were unused for UNUSED_DAYS."""
    (CACHE_DIR / "complete").touch()
    oldest = time.time() - UNUSED_DAYS * 86400.0
    for folder in CACHE_DIR.parent.glob("kernels-*"):
        with suppress(FileNotFoundError):  # another process may be removing it
            if folder != CACHE_DIR and _last_used(folder) < oldest and not _is_in_use(folder):
                shutil.rmtree(folder, ignore_errors=True)


def _last_used(folder: Path) -> float:
    mark = folder / "complete"
    return (mark if mark.exists() else folder).stat().st_mtime


def _lock() -> None:
    """Show, until this process ends, that its kernels are in use."""
    if CACHE_DIR in _locks:
        return
    for n in range(MAX_USERS):
        file = os.open(CACHE_DIR / f"in-use.{n}", os.O_WRONLY | os.O_CREAT)
        with suppress(OSError):  # a file system without locks cannot tell that a folder is free, either
            if not lock_descriptor(file, blocking=False):
                os.close(file)
                continue
        _locks[CACHE_DIR] = file
        return


def _is_in_use(folder: Path) -> bool:
    """Whether a live process uses the kernels of a folder; also if that cannot be found out."""
    try:
        for path in folder.glob("in-use.*"):
            with path.open("ab") as file:
                if not lock_descriptor(file.fileno(), blocking=False):
                    return True
    except OSError:
        return True
    return False
