"""What a dwell costs at the built-in front end, at a Python file, and at a process that is asked over Zenoh."""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.emulator.foreign import ForeignFrontEnd, question
from cogradar.services.emulator.front_end import ScanData, Settings, Transmission, receive
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.errors import RunFailed
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.front_ends.messages import Hello, Received
from cogradar.shared.protocol.messages import EmulatorCheckpoint
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.wire.codec import encode
from cogradar.shared.wire.front_ends.line import Line
from cogradar.shared.wire.front_ends.steady import Steady, serve
from cogradar.shared.wire.session import free_port

CELLS = (1, 10, 390)  # range cells of the look
REPEATS, SPEND_S = 5, 2.0  # of a case: at least so many dwells, and for about so long
NAME, RUN = "bench", "bench"
GIGABIT = 1e9 / 8.0  # bytes a second
STARTS_WITHIN_S = 60.0


class Cost(NamedTuple):
    """Time of a dwell from the transmission to the scan."""

    front_end: str
    range_cells: int
    ms: float  # the median
    n_byte: int | None = None  # of question and answer; None: none leaves the process
    way_ms: float | None = None  # from the question to the answer, which is part of `ms`

    def rate(self, n_gigabit: float) -> float | None:
        """Dwells a second that a link carries."""
        return None if self.n_byte is None else n_gigabit * GIGABIT / self.n_byte


def measure(tell: Callable[[str], None]) -> list[Cost]:
    """Cost of a look at 1, 10 and 390 range cells with an array of 100 x 100 channels."""
    scenario = load("paper-best-range")
    radar, world = scenario.radar, scenario.simulated
    settings = Settings(RUN, radar, Strategy.POWER_AWARE, 1000, 0.0)
    said: dict[str, Any] = {"run": RUN, "radar": radar.model_dump(), "world": world.model_dump(), "dwells": 1000}
    said |= {"strategy": Strategy.POWER_AWARE, "seed": radar_seed(1), "world_seed": 1, "k": 0, "t": 0}
    built_in = SimulatedFrontEnd.open(EmulatorCheckpoint.model_validate(said))
    look = built_in.transmit(0, 0, _asked(radar.array.n_tx, 1))
    n_tx, n_rx = radar.array.n_tx, radar.array.n_rx
    rng = np.random.default_rng(1)
    y = (rng.standard_normal((max(CELLS), n_tx, n_rx)) + 1j * rng.standard_normal((max(CELLS), n_tx, n_rx))).astype(
        np.complex64
    )

    def test(_k: int, _t: int, asked: Transmission) -> ScanData:
        return receive({cell: y[cell] for cell in asked.range_cells}, asked, radar)

    tell("front ends in this process")
    costs = [Cost("built-in", n, _median_ms(built_in.transmit, _asked(n_tx, n))) for n in CELLS]
    costs += [Cost("Python file, Y", n, _median_ms(test, _asked(n_tx, n))) for n in CELLS]
    hello = Hello(run=RUN, incarnation="x", n_tx=n_tx, n_rx=n_rx, hands_over="looks", max_rate_hz=1000.0, clock="none")
    rows = {name: getattr(look, name) for name in Received.model_fields if hasattr(look, name)}
    answer = Received.model_validate({"run": RUN, "incarnation": "x", "k": 0} | rows)
    ways = (("looks", True, CELLS[:1]), ("Y in shared memory", True, CELLS), ("Y by TCP on loopback", False, CELLS))
    for what, shares_memory, cells in ways:
        tell(f"zenoh, {what}")
        has_data = what != "looks"
        said_hello = hello.model_copy(update={"hands_over": "data"}) if has_data else hello
        sent = answer.model_copy(update=dict.fromkeys(rows)) if has_data else answer
        with _opened(settings, said_hello, sent, shares_memory=shares_memory) as (line, front_end):
            for n in cells:
                n_byte = len(encode(sent)) + (y[:n].nbytes + 4 * n if has_data else 0)
                asked = _asked(n_tx, n)
                n_byte += len(encode(question(RUN, 0, 0, asked, 1.0)))

                def way(k: int, t: int, asked: Transmission, line: Line = line) -> object:
                    return next(iter(line.transmit(question(RUN, k, t, asked, 1.0), STARTS_WITHIN_S)))

                way_ms = _median_ms(way, asked)
                costs.append(Cost(f"zenoh, {what}", n, _median_ms(front_end.transmit, asked), n_byte, way_ms))
    return costs


@contextmanager
def _opened(
    settings: Settings, hello: Hello, answer: Received, *, shares_memory: bool
) -> Iterator[tuple[Line, ForeignFrontEnd]]:
    """A front end in a process of its own."""
    context, endpoint = multiprocessing.get_context("spawn"), f"tcp/127.0.0.1:{free_port()}"
    is_up, stop = context.Event(), context.Event()
    steady = Steady(NAME, endpoint, encode(hello), encode(answer), shares_memory)
    process = context.Process(target=serve, args=(steady, is_up, stop), daemon=True)
    process.start()
    try:
        if not is_up.wait(STARTS_WITHIN_S):
            raise RunFailed(f"the front end of the measurement is not there within {STARTS_WITHIN_S:g} s")
        line = Line(NAME, [endpoint], STARTS_WITHIN_S, lambda: None)
        front_end = ForeignFrontEnd.open(NAME, settings, settings.radar.model_dump(), line, STARTS_WITHIN_S)
        try:
            yield line, front_end
        finally:
            front_end.close()
    finally:
        stop.set()
        process.join()


def _asked(n_tx: int, n_cell: int) -> Transmission:
    """A look at some range cells while power goes everywhere."""
    looks = [Look(0.1, n_tx // 2, range(n_cell), threshold(1e-6))]
    none = np.empty((n_tx, 0), np.complex128)
    beams, nus, gates = np.full((1, 1), -1, np.int32), np.zeros((1, 1)), np.zeros((1, 2))
    return Transmission(1.0, none, beams, np.array([n_tx // 2], np.int32), looks, nus, gates)


def _median_ms(transmit: Callable[[int, int, Transmission], object], asked: Transmission) -> float:
    spent = list[float]()
    transmit(0, 0, asked)  # what is kept from one dwell to the next
    begun = time.perf_counter()
    while len(spent) < REPEATS or time.perf_counter() < begun + SPEND_S:
        spent.append(_ms(partial(transmit, len(spent) + 1, 0, asked)))
    return float(np.median(spent))


def _ms(step: Callable[[], object]) -> float:
    before_s = time.perf_counter()
    step()
    return 1e3 * (time.perf_counter() - before_s)


def table(costs: list[Cost]) -> Table:
    """Each front end with each number of range cells."""
    columns = [
        *(Column("front end", "{front_end}", left=True), Column("range cells", "{range_cells}")),
        *(
            Column("ms a dwell", "{ms:.2f}"),
            Column("ms of it, way", "{way_ms:.2f}"),
            Column("bytes a dwell", "{n_byte}"),
        ),
        *(Column("dwells/s, 1 Gbit/s", "{at_1:.0f}"), Column("dwells/s, 10 Gbit/s", "{at_10:.0f}")),
    ]
    return Table("one look of an array of 100 x 100 channels", columns, [row(one) for one in costs])


def row(cost: Cost) -> dict[str, object]:
    """As a document."""
    return cost._asdict() | {"at_1": cost.rate(1.0), "at_10": cost.rate(10.0)}
