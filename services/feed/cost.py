"""What a feed takes of a core: to make a picture of the messages of a dwell, and to pack it in each format."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import BadInput
from cogradar.services.feed.feed import FORMATS, Options
from cogradar.services.feed.picture import PARTS, Picture, Pictures
from cogradar.services.feed.sapient.node import Sapient, acceptance
from cogradar.shared.protocol.messages import Plan, Waveform
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.scenario import SiteSection
from cogradar.shared.wire.codec import decode, encode

GOAL = 0.2  # of a core, for so many tracks in each second
PICTURES = "messages to pictures"
_SITE = SiteSection(latitude_deg=48.35, longitude_deg=11.79, height_m=450.0, boresight_deg=60.0)
_UTC_S, _RUN = 1_790_000_000.0, "feed-1"


class Cost(NamedTuple):
    """Processor time of one step for a picture."""

    step: str
    tracks: int
    ms: float | None  # of all tracks, the median picture; None: the package of the format is not installed

    @property
    def share(self) -> float | None:
        """Of a core, with a picture each second."""
        return None if self.ms is None else 1e-3 * self.ms


def measure(n_track: int, pictures: int, tell: Callable[[str], None]) -> list[Cost]:
    """Cost of pictures of so many tracks, which move and are all reported each time."""
    tell(PICTURES)
    made, spent = pictures_of(n_track, pictures)
    costs = [Cost(PICTURES, n_track, spent)]
    for name, kind in FORMATS.items():
        tell(name)
        try:
            form = kind.make(Options())
        except BadInput:
            costs.append(Cost(name, n_track, None))
            continue
        if isinstance(form, Sapient):
            form.answer(acceptance())
        form.encode(made[0])  # in which all tracks begin
        costs.append(Cost(name, n_track, _median_ms([partial(form.encode, one) for one in made[1:]])))
    return costs


def pictures_of(n_track: int, n: int) -> tuple[list[Picture], float]:
    """Pictures as they come of messages, the first one more than `n`, and how long one takes in ms."""
    scenario = load("traffic")
    taking, made = Pictures(_RUN, scenario, _SITE), list[Picture]()
    draw, n_tx = np.random.default_rng(1), scenario.radar.array.n_tx
    places = draw.uniform(5.0, 90.0, n_track), draw.uniform(-50.0, 50.0, n_track)
    states = np.column_stack((places[0], draw.normal(0.0, 0.2, n_track), places[1], np.zeros(n_track)))

    def take(payloads: Sequence[bytes], utc_s: float) -> None:
        for payload in payloads:
            made.extend(taking.take(decode(payload, PARTS), 0.0, utc_s))

    spent = []
    for k in range(n + 1):
        states[:, 0] += states[:, 1]
        payloads = [encode(_plan(k, track, state)) for track, state in enumerate(states)]
        payloads.append(encode(_waveform(k, n_tx)))
        spent.append(_ms(partial(take, payloads, _UTC_S + k)))
    return made, float(np.median(spent[1:]))


def _plan(k: int, track: int, state: NDArray[np.float64]) -> Plan:
    cells: dict[str, Any] = {"bins": np.zeros(1, np.int32), "chances": np.ones(1), "best_bin": 0, "nus": np.zeros(1)}
    belief: dict[str, Any] = {
        "estimate": state.copy(),
        "covariance": np.diag([0.01, 1e-4, 0.01, 1e-4]),
        "detected": True,
    }
    of_one: dict[str, Any] = {"existence": 0.99, "confirmed": True, "in_doubt": False, "gate": np.zeros(2)}
    return Plan(run=_RUN, k=k, t=k + 1, target=track, status="tracking", range_km=50.0, **cells, **belief, **of_one)


def _waveform(k: int, n_tx: int) -> Waveform:
    """One that answers the plans; of the rest a picture takes nothing."""
    return Waveform(
        run=_RUN,
        k=k,
        tracking=False,
        isotropic=1.0,
        factor=np.empty((n_tx, 0), np.complex64),
        beams=np.full((1, 1), -1, np.int32),
        shares=np.zeros((1, 1)),
        status="acquisition",
        late=np.zeros(1, np.int32),
    )


def _median_ms(steps: Sequence[Callable[[], object]]) -> float:
    return float(np.median([_ms(step) for step in steps]))


def _ms(step: Callable[[], object]) -> float:
    """Processor time, which does not count what else a machine does."""
    before_s = time.process_time()
    step()
    return 1e3 * (time.process_time() - before_s)


def table(costs: Sequence[Cost]) -> Table:
    """Each step, and its share of a core with a picture each second."""
    columns = [
        Column("step", "{step}", left=True),
        Column("tracks", "{tracks}"),
        Column("ms", "{ms:.1f}"),
        Column("µs a track", "{us:.1f}"),
        Column("share of a core", "{share:.3f}"),
    ]
    return Table(
        f"a picture a second; goal: {GOAL:g} of a core for a format and the pictures",
        columns,
        [row(one) for one in costs],
    )


def row(cost: Cost) -> Mapping[str, object]:
    """As a document."""
    us = None if cost.ms is None else 1e3 * cost.ms / cost.tracks
    return cost._asdict() | {"us": us, "share": cost.share}
