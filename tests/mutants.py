"""Faults planted in the program, and how many schedules the simulator needs to find each: `python -m tests.mutants`.

A planted fault is one replacement in the source of one module. It is made while the module is imported, in a process of
its own; no file is changed. The fault is found by the first schedule that is violated, which without it holds.
"""

import argparse
import importlib.machinery
import itertools
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from threading import Lock
from typing import Any

from cogradar.services.analysis.pages import write_into
from cogradar.shared.protocol.build import build
from tests.planted_faults import MUTANTS, Mutant

SCHEDULES = 2000
OF_HARMLESS = 500  # schedules of a fault that another mechanism makes up for
AT_ONCE = 500  # schedules between two times at which what was played is kept
REMEMBERED = 30_000  # results
SAID = 150  # characters of what is violated
FIRST = 1_000_000_000  # seed: none that is played elsewhere


def planted(mutant: Mutant, text: str) -> str:
    """The source with the fault in it. Raises ValueError unless its place is there, once."""
    if (n := text.count(mutant.old)) != 1:
        raise ValueError(f"{mutant.module} has {mutant.old!r} {n} times")
    return text.replace(mutant.old, mutant.new)


def _plant(mutant: Mutant) -> None:
    """Let this process compile the mutant in place of the module."""
    path = (Path(__file__).parents[1] / mutant.module).resolve()
    compile_source: Callable[..., Any] = importlib.machinery.SourceFileLoader.source_to_code

    def get_code(self: Any, fullname: str) -> Any:
        file = self.get_filename(fullname)
        if Path(file).resolve() != path:
            return usual(self, fullname)
        return compile_source(self, planted(mutant, path.read_text(encoding="utf-8")), file)

    usual: Callable[..., Any] = importlib.machinery.SourceFileLoader.get_code
    importlib.machinery.SourceFileLoader.get_code = get_code  # type: ignore[method-assign]


def play(mutant: Mutant, schedules: int, after: int = 0, *, is_planted: bool = True) -> tuple[int, str]:
    """Which of so many schedules that come to the fault's place, behind `after`, is violated first, or 0; and how."""
    if is_planted:
        _plant(mutant)
    simulation = "cogradar.services.simulation."
    memory, schedule, simulator = (import_module(simulation + name) for name in ("memory", "schedule", "simulator"))
    all_drawn = (schedule.Schedule.draw(seed) for seed in itertools.count(FIRST))
    chosen = filter(mutant.only, all_drawn)
    with memory.remembering(REMEMBERED):
        for n, drawn in enumerate(itertools.islice(chosen, after, schedules), after + 1):
            if violation := simulator.play(drawn).violation:
                return n, str(violation)
    return 0, ""


def _in_a_process(mutant: Mutant, schedules: int, after: int, *, is_planted: bool = True) -> tuple[int, str]:
    command = [sys.executable, "-m", "tests.mutants", "--play" if is_planted else "--without", mutant.name]
    command += ["--schedules", str(schedules), "--after", str(after)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{mutant.name}: {done.stderr}")
    found, violation = json.loads(done.stdout.splitlines()[-1])
    return found, violation


class Known:
    """What earlier calls found of mutants, in this program."""

    def __init__(self, file: Path | None) -> None:
        """`file`: None: nothing is kept."""
        self._file, self._lock = file, Lock()
        kept = json.loads(file.read_text(encoding="utf-8")) if file is not None and file.exists() else {}
        self._found: dict[str, tuple[int, int, str]] = kept.get(build(), {})

    def play(self, mutant: Mutant, schedules: int) -> tuple[int, int, str]:
        """How many schedules were played, and the first one that is violated, 0 if none is; none is played again."""
        key = f"{mutant.module}: {mutant.old} -> {mutant.new}, {mutant.only.__name__}"
        played, n, violation = self._found.get(key, (0, 0, ""))
        at_once = schedules if self._file is None else AT_ONCE
        while not n and played < schedules:
            until = min(played + at_once, schedules)
            n, violation = _in_a_process(mutant, until, played)
            if n and _in_a_process(mutant, n, n - 1, is_planted=False)[0]:
                print(f"{mutant.name}: schedule {n} fails without it, too: {violation}", file=sys.stderr)
                until, n, violation = n, 0, ""
            played = until
            with self._lock:
                self._found[key] = played, n, violation
                if self._file is not None:
                    self._file.write_text(json.dumps({build(): self._found}, indent=1), encoding="utf-8")
        return played, n, violation


def _row(mutant: Mutant, played: int, n: int, violation: str) -> str:
    told = re.sub(r"/\S+/(\d+\.db)", r"\1", violation)  # the journal, wherever it was
    said = told.splitlines()[0][:SAID].replace("|", "/") if violation else mutant.harmless or mutant.missed
    return f"| {mutant.name} | {n or (f'not in {played}' if played else 'not played yet')} | {said} |"


def main() -> int:
    """Print a row for each planted fault; 1 if one is not found that was, or one is found that was not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="only those whose name has one of these words")
    parser.add_argument("--schedules", type=int, default=SCHEDULES)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--into", type=Path, metavar="PAGE", help="write the table there, between <!-- planted -->")
    parser.add_argument("--store", type=Path, metavar="FILE", help="keep there what was played, and go on from it")
    parser.add_argument("--play", metavar="NAME", help=argparse.SUPPRESS)
    parser.add_argument("--without", metavar="NAME", help=argparse.SUPPRESS)
    parser.add_argument("--after", type=int, default=0, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if name := asked.play or asked.without:
        mutant = next(one for one in MUTANTS if one.name == name)
        print(json.dumps(play(mutant, asked.schedules, asked.after, is_planted=bool(asked.play))))
        return 0
    chosen = [one for one in MUTANTS if not asked.names or any(word in one.name for word in asked.names)]
    rows, wrong, n_found, known = list[str](), 0, 0, Known(asked.store)
    with ThreadPoolExecutor(asked.workers) as pool:
        most = [min(asked.schedules, OF_HARMLESS if one.harmless else asked.schedules) for one in chosen]
        outcomes = pool.map(known.play, chosen, most)
        for mutant, (played, n, violation) in zip(chosen, outcomes, strict=True):
            wrong += bool(n) == (bool(mutant.harmless) or bool(mutant.missed))
            n_found += bool(n)
            rows.append(_row(mutant, played, n, violation))
            print(rows[-1], flush=True)
    harmless = sum(bool(one.harmless) for one in chosen)
    said = f"{n_found} of {len(chosen) - harmless} planted faults were found, {harmless} change no run"
    print(f"{said}; {wrong} are not as expected")
    if asked.into:
        table = ["| planted fault | schedules | what is violated, or why nothing is |", "|---|---:|---|", *rows]
        write_into(asked.into, {"planted": ["\n".join(table), f"{said} ({datetime.now(UTC):%Y-%m-%d})."]})
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
