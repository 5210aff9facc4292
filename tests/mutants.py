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
from typing import Any, NamedTuple

from cogradar.services.analysis.pages import write_into
from cogradar.shared.protocol.build import build

SCHEDULES = 2000
OF_HARMLESS = 500  # schedules of a fault that another mechanism makes up for
AT_ONCE = 500  # schedules between two times at which what was played is kept
REMEMBERED = 30_000  # results
SAID = 150  # characters of what is violated
FIRST = 1_000_000_000  # seed: none that is played elsewhere


def of_any_kind(_schedule: Any) -> bool:
    """All schedules."""
    return True


class Mutant(NamedTuple):
    """A fault that can be planted."""

    name: str
    module: str  # file, from the root
    old: str
    new: str
    harmless: str = ""  # why no run can be another with it; "": it must be found
    only: Callable[[Any], bool] = of_any_kind  # schedules that come to its place: those are played, and counted
    missed: str = ""  # why no schedule is known in which it does harm, though it is not proven to be harmless


def with_a_flipped_bit(schedule: Any) -> bool:
    """Schedules in which a bit of the journal is another one."""
    return any(fault.kind == "rot" for fault in schedule.faults)


def in_real_time(schedule: Any) -> bool:
    """Schedules of runs in real time."""
    return bool(schedule.rate_hz)


def with_pools(schedule: Any) -> bool:
    """Schedules with several emulators and allocators."""
    return bool(schedule.pool > 1)


def with_pools_and_a_router_that_restarts(schedule: Any) -> bool:
    """Schedules with pools whose router is away for a while."""
    return with_pools(schedule) and any(fault.kind == "router" for fault in schedule.faults)


def that_go_on_for_long(schedule: Any) -> bool:
    """Schedules in real time of several planners, in which all is well again long before the end."""
    return bool(schedule.dwells > 100 and schedule.planners > 1)


def with_commands(schedule: Any) -> bool:
    """Schedules whose runs are commanded."""
    return bool(schedule.commands)


RECORDER, RUN, JOURNAL = (
    "services/recorder/core.py",
    "services/recorder/recorded_run.py",
    "services/recorder/journal.py",
)
PLANNER, PLANNED, HELD = "services/planner/core.py", "services/planner/run.py", "services/planner/held_tracks.py"
ALLOCATOR, EMULATOR = "services/allocator/core.py", "services/emulator/core.py"
MEMBERS, SHARES = "shared/wire/pool/members.py", "shared/wire/pool/shares.py"
PACING, RESEND = "services/delivery/pacing.py", "services/delivery/resend.py"

MUTANTS = (
    # Recorder and journal.
    Mutant(
        "a checkpoint is sent before its transaction is committed",
        RECORDER,
        "        self._journal.commit()\n        self._uncommitted_ticks = 0",
        "        self._uncommitted_ticks = 0",
    ),
    Mutant(
        "a dwell is complete without its waveform",
        RUN,
        "has_truth and dwell.has_waveform and self._is_planned(dwell)",
        "has_truth and self._is_planned(dwell)",
    ),
    Mutant("a dwell is complete without its truth", RUN, "dwell.has_truth or not self._has_truth", "True"),
    Mutant(
        "the recorder never asks for anything again",
        RUN,
        "        k, t = self.acknowledged\n        now =",
        "        (k, t), resend = self.acknowledged, False\n        now =",
    ),
    Mutant(
        "a recorder that comes back begins unfinished runs at the next dwell",
        RECORDER,
        "run = RecordedRun(start, k, t",
        "run = RecordedRun(start, k + 1, t",
    ),
    Mutant(
        "the first message of a dwell is overwritten by a later one",
        JOURNAL,
        "INSERT INTO message VALUES (?,?,?,?,?,?) ON CONFLICT DO NOTHING",
        "INSERT OR REPLACE INTO message VALUES (?,?,?,?,?,?)",
    ),
    Mutant(
        "snapshots of dwells that are not acknowledged are kept",
        RECORDER,
        "if snapshot.k >= run.acknowledged[0]:",
        "if snapshot.k >= run.acknowledged[0] + 999:",
    ),
    Mutant(
        "checksums of messages are not looked at",
        JOURNAL,
        "message_checksum(run, k, topic, item, payload) != known",
        "known is None",
        only=with_a_flipped_bit,
    ),
    Mutant(
        "an older snapshot replaces a newer one",
        JOURNAL,
        "payload = excluded.payload WHERE excluded.k > snapshot.k",
        "payload = excluded.payload",
        harmless="a new owner observes more scans, and is where it would be",
    ),
    Mutant(
        "messages before their run begins are dropped by the recorder",
        RECORDER,
        "                self._pending.add(message)\n            return ()",
        "                pass\n            return ()",
        harmless="they are asked for again",
    ),
    Mutant(
        "a deposed recorder goes on",
        RECORDER,
        "if heard.epoch > journal.epoch:",
        "if False:",
        harmless="the look for a higher epoch inside each transaction ends it",
    ),
    Mutant(
        "epochs are not looked at inside a transaction",
        "services/recorder/store/database.py",
        "if self.epoch and (newest := self._newest()).epoch > self.epoch:",
        "if (newest := self._newest()).epoch < 0:",
    ),
    Mutant("overdue plans are never named", RUN, '"overdue": list(self._overdue)', '"overdue": []'),
    Mutant(
        "an order is told of from the next checkpoint on only",
        RECORDER,
        "return [*answers, *run.checkpoint()]",
        "return answers",
        harmless="no dwell that it shapes is answered before a later checkpoint, which says it, too",
    ),
    # Planners.
    Mutant(
        "the death of a planner is not noticed",
        PLANNER,
        "self._workers = tuple(sorted(there))",
        "self._workers = tuple(sorted({*there, *self._workers}))",
    ),
    Mutant(
        "no track is taken from a planner that brings no plans",
        PLANNER,
        "if not overdue or self._now_s <",
        "if True or self._now_s <",
    ),
    Mutant(
        "searches go on with the random numbers of the one before",
        "services/planner/decision.py",
        "rng = generator(model.seed, Purpose.SEARCH, state.target, state.k)",
        'rng = globals().setdefault("_rng", generator(model.seed, Purpose.SEARCH, 0, 0))',
    ),
    Mutant(
        "a track that is restored lacks a dwell",
        PLANNED,
        "state_of(self._model, snapshot), self._newest",
        "state_of(self._model, snapshot)._replace(k=snapshot.k + 2), self._newest",
    ),
    Mutant("plans are not kept to be sent again", PLANNED, "self.resend.add(plan.k, (plan,))", "pass"),
    Mutant(
        "a planner keeps tracks that another one has taken",
        PLANNED,
        "self._held.leave(said)",
        "pass",
        only=that_go_on_for_long,
    ),
    Mutant(
        "missing scans are not asked for",
        PLANNED,
        "lacking = {m: self._next_k(m) for m in self._held.all if self._recall.may_ask(m)}",
        "lacking: dict[int, int] = {}",
    ),
    Mutant(
        "a planner that joins never plans in real time",
        PLANNED,
        "if track is not None and track.k > self._newest and",
        "if False and",
        only=in_real_time,
    ),
    Mutant(
        "every plan in real time is seven bins off",
        PLANNED,
        "        if self._model.existence.is_over(state, max(",
        "        if self._pacing.has_deadlines:\n"
        "            seven_off = (decision.bins + 7) % self.radar.array.n_bin\n"
        "            decision = type(decision)(**vars(decision) | {'bins': seven_off})\n"
        "        if self._model.existence.is_over(state, max(",
        only=in_real_time,
    ),
    # Allocator.
    Mutant(
        "the allocator is deaf to plans in real time",
        ALLOCATOR,
        "    run.tracks.note(plan)\n",
        "    if run.pacing.has_deadlines:\n        return ()\n    run.tracks.note(plan)\n",
        only=in_real_time,
    ),
    Mutant(
        "a waveform is made before all plans are there",
        ALLOCATOR,
        "len(plans) >= len(ids) and plans.keys() >= ids",
        "len(plans) >= len(ids) - 1",
    ),
    Mutant(
        "a rewound allocator keeps what it knew",
        ALLOCATOR,
        "if run is not None and not run.resend.is_rewound_by(checkpoint):",
        "if run is not None:",
        missed="it would make the same again, unless the older journal lacks orders: no such schedule is drawn",
    ),
    Mutant(
        "the allocator never hears of orders",
        ALLOCATOR,
        "            run.orders = checkpoint.orders\n",
        "            pass\n",
        only=with_commands,
    ),
    Mutant(
        "the allocator answers twice as late in real time",
        ALLOCATOR,
        "run.due_s, run.wait_s = now_s + run.wait_s, None",
        "run.due_s, run.wait_s = now_s + 20.0 * run.wait_s, None",
        only=in_real_time,
    ),
    # Emulator.
    Mutant(
        "the emulator runs further ahead than it may",
        PACING,
        "return ahead < MAX_AHEAD_DWELLS\n\n    def first_open",
        "return True\n\n    def first_open",
        only=with_commands,
    ),
    Mutant(
        "a repeated waveform replaces the first one",
        EMULATOR,
        "run.waveforms.setdefault(waveform.k, waveform)",
        "run.waveforms[waveform.k] = waveform",
        missed="what is repeated is the same, byte for byte, unless an older journal lacks orders: none is drawn",
    ),
    Mutant(
        "the emulator does not recall its last waveform",
        EMULATOR,
        "return (WaveformRecall(run=run.settings.run, k=run.k - 1),) if lacks else ()",
        "return ()",
    ),
    Mutant(
        "an emulator that comes back begins at dwell 0",
        EMULATOR,
        "            k=checkpoint.k,\n            t=checkpoint.t,",
        "            k=0,\n            t=0,",
        missed="in lockstep dwells are the same again, in real time a checkpoint or a waveform says which one is due",
    ),
    Mutant(
        "overdue dwells are made up for in real time",
        PACING,
        "(now_s if now_s >= due_s + self.period_s else due_s) + self.period_s",
        "due_s + self.period_s",
        only=in_real_time,
    ),
    Mutant(
        "a limit of power is not kept by the emulator",
        EMULATOR,
        "return limited(transmission(run.radar, waveform), most)",
        "return transmission(run.radar, waveform)",
        only=with_commands,
    ),
    # Delivery.
    Mutant(
        "what is asked for again is sent from the second dwell on",
        RESEND,
        "for dwell in sorted(self._sent) for",
        "for dwell in sorted(self._sent)[1:] for",
    ),
    Mutant("a rewound run is not noticed", RESEND, "return checkpoint.k < self.k and", "return False and"),
    Mutant(
        "each planner takes another one for the owner",
        PLANNER,
        "[worker for worker in self._workers if worker not in suspended]",
        "[one for one in self._workers if one not in suspended and (one != self._name or len(self._workers) == 1)]",
    ),
    # Pools.
    Mutant(
        "a process of a pool that was frozen goes on before it asks for claims",
        MEMBERS,
        "if (gap_s := now_s - self._looked_s) > PAUSE_S:",
        "if (gap_s := now_s - self._looked_s) > 1e9:",
        only=with_pools,
    ),
    Mutant(
        "of two claims to a shard both stay",
        SHARES,
        "for shard, since_s in earlier.items():",
        "for shard, since_s in {}.items():",
        only=with_pools,
    ),
    Mutant(
        "the tokens of a pool are never looked at again",
        MEMBERS,
        "        if own >= self._shown.keys():\n            others",
        "        if False:\n            others",
        only=with_pools,
    ),
    Mutant(
        "a core is not told of shards that its process has lost",
        MEMBERS,
        "        if self._told == self._shares.held:",
        "        if self._told is not None and self._told >= self._shares.held:",
        only=with_pools,
    ),
    Mutant(
        "claims of a process that is gone are kept",
        SHARES,
        "self._claims = {one: seen for one, seen in self._claims.items() if now_s < seen.absent_s + LEAVE_AFTER_S}",
        "pass",
        only=with_pools,
    ),
    Mutant(
        "claims are taken while the router is away",
        SHARES,
        "if absent and not is_connected():",
        "if absent and is_connected() is None:",
        only=with_pools_and_a_router_that_restarts,
        missed="before it goes on, a process that had no router asks for all claims, and leaves its runs to others",
    ),
    Mutant(
        "a shard is served as soon as it is claimed",
        SHARES,
        "(UNTAKEN_S if shard in rivalled else SETTLE_S)",
        "0.0",
        only=with_pools,
        missed="before it serves a shard a process looks again, and word of other claims has come by then",
    ),
)


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
