"""A run without an end, as fast as one process plays it: what it holds and what a dwell costs must not grow.

The cores are the real ones, with metrics beside them that scores every dwell. The journal is a file that is cut behind
the run. It stands for weeks at 10 Hz: nothing in it knows how fast the clock on the wall goes. With a store it goes on
where it was stopped, as a restart of everything does.
"""

import json
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.errors import BadInput, check_stop
from cogradar.services.front_ends import open_front_end
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal, Retention
from cogradar.services.runs.launcher import scratch
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import Message, RunStart, Scan
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.bus import Bus, LocalNetwork
from cogradar.shared.wire.runner import Core, handle, step

# Two aircraft that come and go in a small array, beside a search that finds noise now and then.
SETTINGS = ("radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2", "world.repeat_s=60")
KEEP = Retention(bytes_of_run=20_000_000)
SAMPLE_DWELLS = 500
RATE_HZ = 10.0  # at which the days are said
WHAT = {"rss_mib": "memory", "journal_mib": "journal", "p50_ms": "CPU of a dwell, half", "p99_ms": "... 99 %"}
GROWTH, SLACK = 0.1, {"MiB": 8.0, "ms": 2.0}  # from the middle third to the last one: a share, or so much


@dataclass
class Timed:
    """An emulator's core that notes when it transmits, in CPU time: how busy the machine is does not count."""

    core: EmulatorCore
    times_s: list[float] = field(default_factory=list)

    def handle(self, event: Event) -> Sequence[Message]:
        """What the core answers."""
        answers = self.core.handle(event)
        self.times_s += [time.process_time() for answer in answers if isinstance(answer, Scan)]
        return answers


@dataclass(frozen=True)
class Sample:
    """What there is after so many dwells."""

    dwells: int
    start: int  # of the processes, from 0: what they hold begins anew
    rss_mib: float
    journal_mib: float
    p50_ms: float
    p99_ms: float
    kept: int  # dwells in the journal
    next_track: int


@dataclass(frozen=True)
class Endless:
    """What came of it."""

    minutes: float
    samples: list[Sample]

    def thirds(self) -> list[dict[str, Any]]:
        """What is held and the CPU time of a dwell: medians of the middle third of the dwells and of the last.

        Memory is compared within the longest of the starts: it begins anew with each.
        """
        (longest, _), *_ = Counter(sample.start for sample in self.samples).most_common(1)
        of_start, found = [sample for sample in self.samples if sample.start == longest], []
        for name, what in WHAT.items():
            unit = "ms" if name.endswith("_ms") else "MiB"
            of_all = [getattr(sample, name) for sample in (of_start if name == "rss_mib" else self.samples)]
            third = len(of_all) // 3
            before, after = (median(part or of_all) for part in (of_all[third:-third], of_all[-third:]))
            is_flat = after <= max(before * (1.0 + GROWTH), before + SLACK[unit])
            row = {"what": what, "unit": unit, "before": before, "after": after}
            found.append(row | {"most": max(of_all), "verdict": "flat" if is_flat else "grows"})
        return found

    @property
    def faults(self) -> list[str]:
        """What grows."""
        rows = [row for row in self.thirds() if row["verdict"] == "grows"]
        return [f"{row['what']}: {row['before']:.1f} {row['unit']}, then {row['after']:.1f}" for row in rows]

    def as_json(self) -> dict[str, Any]:
        """The same as a document."""
        return {"minutes": self.minutes, "samples": [asdict(one) for one in self.samples], "thirds": self.thirds()}

    def table(self) -> Table:
        """A row for all that is held."""
        columns = [
            Column("what", "{what}", left=True),
            Column("unit", "{unit}", left=True),
            Column("middle third", "{before:.1f}"),
            Column("last third", "{after:.1f}"),
            Column("most", "{most:.1f}"),
            Column("", "{verdict}", left=True),
        ]
        last = self.samples[-1]
        caption = f"{last.dwells} dwells, of which {last.kept} are kept; the next track is {last.next_track}"
        return Table(caption, columns, self.thirds())


def play(
    minutes: float,
    seed: int,
    notify: Callable[[str], None],
    stop: threading.Event,
    dwells: int | None = None,
    store: str | None = None,
) -> Endless:
    """Play for so long, or so many dwells; what a store has already counts. Raises Interrupted, BadInput."""
    if not Path("/proc/self/status").exists():
        raise BadInput("endless reads /proc, which this system does not have")
    with scratch() if store is None else nullcontext(store) as place:
        path = Path(place) / "run.db" if store is None else Path(place)
        samples = _kept(path)
        start = samples[-1].start + 1 if samples else 0
        began, journal = time.monotonic(), Journal(str(path))
        emulator, metrics = Timed(EmulatorCore(open_front_end("simulated"))), MetricsCore(str(path))
        cores: dict[Role, Core] = {
            Role.RECORDER: RecorderCore(journal, resume=True, keep=KEEP),
            Role.EMULATOR: emulator,
            Role.PLANNER: PlannerCore("planner-0"),
            Role.ALLOCATOR: AllocatorCore(),
            Role.METRICS: metrics,
        }
        network = LocalNetwork()
        endpoints = [(core, network.endpoint(role, f"{role}-0")) for role, core in cores.items()]
        if not journal.read("SELECT 1 FROM run"):
            network.deliver(RunStart.of(load("smoke", SETTINGS), Strategy.POWER_AWARE, seed, NO_END))
        try:
            while not samples or (samples[-1].dwells < dwells if dwells else time.monotonic() - began < 60.0 * minutes):
                if not _turn(endpoints):
                    for core, bus in endpoints:
                        handle(core, bus, Tick(time.monotonic()))
                check_stop(stop, "" if store is None else f"; {store} keeps what was played")
                if len(emulator.times_s) > SAMPLE_DWELLS:
                    samples.append(_sample(journal, path, start, emulator.times_s))
                    emulator.times_s = emulator.times_s[-1:]
                    _keep(path, samples[-1])
                    days = samples[-1].dwells / RATE_HZ / 86400.0
                    notify(f"{samples[-1].dwells} dwells, {days:.2f} days at {RATE_HZ:g} Hz")
        finally:
            metrics.close()
            journal.close()
    return Endless(minutes, samples)


def _samples_of(store: Path) -> Path:
    return Path(f"{store}.samples.jsonl")


def _keep(store: Path, sample: Sample) -> None:
    with _samples_of(store).open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(sample)) + "\n")


def _kept(store: Path) -> list[Sample]:
    """What was sampled before; the end of a line that was cut off is removed. Raises BadInput."""
    path = _samples_of(store)
    if store.exists() and not path.exists():
        raise BadInput(f"{store}: there is no {path.name} beside it, so it is no store of this study; name another")
    path.touch()
    *lines, end = path.read_text(encoding="utf-8").split("\n")
    try:
        samples = [Sample(**json.loads(line)) for line in lines]
    except (ValueError, TypeError) as error:
        raise BadInput(f"{path}: no samples of this study: {error}") from None
    if end:  # or the next sample would be written behind it
        os.truncate(path, path.stat().st_size - len(end.encode()))
    return samples


def _turn(endpoints: Iterable[tuple[Core, Bus]]) -> bool:
    """Let every core handle what waits for it; false if there was nothing."""
    busy = False
    for core, bus in endpoints:
        while step(core, bus, 0.0):
            busy = True
    return busy


def _sample(journal: Journal, store: Path, start: int, times_s: Sequence[float]) -> Sample:
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines())
    files = [file for end in ("", "-wal") if (file := Path(f"{store}{end}")).exists()]
    took_ms = 1e3 * np.diff(times_s)
    (row,) = journal.read("SELECT acknowledged_k AS k, acknowledged_k - kept_k AS kept FROM run")
    (item,) = journal.read("SELECT MAX(item) AS track FROM message WHERE topic = 'plan'")
    return Sample(
        row["k"],
        start,
        int(status["VmRSS"].split()[0]) / 1024,
        sum(file.stat().st_size for file in files) / 2**20,
        float(np.quantile(took_ms, 0.5)),
        float(np.quantile(took_ms, 0.99)),
        row["kept"],
        int(item["track"] or 0) + 1,
    )
