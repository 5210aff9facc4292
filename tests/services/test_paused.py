"""Pauses of transmission: nothing is radiated or measured, tracks coast, and none is lost in a few seconds."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.front_end import ScanData, Transmission
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Message, RunStart, Scan, Truth
from cogradar.shared.protocol.orders import PAUSED, Action, Order, Pause, Resume
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.tracking.existence import SURVIVES_S
from cogradar.shared.wire.codec import encode
from tests.services.loop import SMOKE, checkpoint, plans, play, scans, smoke_start, waveforms
from tests.skies import sky_start

FIRST, N = 20, 15
STARTS: dict[str, Callable[[], RunStart]] = {
    "bins": lambda: smoke_start(dwells=40),
    "orthogonal": lambda: smoke_start(Strategy.ORTHOGONAL, dwells=40),
    "steered": lambda: RunStart.of(load("smoke", ["radar.fidelity=best-range"]), Strategy.POWER_AWARE, 1, 40),
    "unknown": lambda: sky_start(dwells=40),
    "isotropic": lambda: sky_start("radar.search.pattern=isotropic", dwells=40),
}
RADIATED: list[int] = []


class Watched(SimulatedFrontEnd):
    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        RADIATED.append(k)
        return super().transmit(k, t, waveform)


@cache
def _played(name: str, *actions: tuple[Action, int]) -> tuple[Message, ...]:
    start = STARTS[name]().model_copy(update={"run": "r"})
    orders = [Order(n=n, k=k, action=action) for n, (action, k) in enumerate(actions, 1)]
    return tuple(play(start, Watched.open, orders))


@pytest.mark.parametrize("name", STARTS)
def test_a_short_pause_radiates_nothing_and_loses_no_track(name: str) -> None:
    RADIATED.clear()
    said = list(_played(name, (Pause(dwells=N), FIRST)))
    paused = list(range(FIRST, FIRST + N))
    assert set(RADIATED).isdisjoint(paused)
    assert [scan.k for scan in scans(said) if not scan.bins.size] == paused
    assert {scan.fault for scan in scans(said)} == {None, PAUSED}
    powers = {one.k + 1: one.isotropic + float(np.sum(np.abs(one.factor) ** 2)) for one in waveforms(said)}
    assert {k for k, power in powers.items() if power == 0.0} == set(paused)
    assert {one.k + 1 for one in waveforms(said) if one.orders is not None} == set(paused)
    before, last = ({p.target: p for p in plans(said) if p.k == k} for k in (FIRST, FIRST + N - 1))
    known = [track for track, plan in before.items() if plan.confirmed is not False]
    assert before.keys() >= last.keys() >= set(known) > set()  # none begins
    for track, plan in last.items():
        assert np.trace(plan.covariance[::2, ::2]) > np.trace(before[track].covariance[::2, ::2])
        if plan.existence is not None and (existence := before[track].existence) is not None:
            assert plan.existence >= existence * np.exp(-N / SURVIVES_S) * 0.99
            assert plan.confirmed == before[track].confirmed
    after = {plan.target: plan for plan in plans(said) if plan.k == max(scan.k for scan in scans(said))}
    assert after.keys() >= set(known)
    assert any(plan.detected for plan in plans(said) if plan.k > FIRST + N)


@pytest.mark.parametrize("name", ["bins", "unknown"])
def test_a_pause_ends_with_its_dwells_or_when_it_is_resumed_and_targets_fly_on_meanwhile(name: str) -> None:
    ended = _played(name, (Pause(dwells=N), FIRST))
    resumed = _played(name, (Pause(), FIRST), (Pause(dwells=3), FIRST + 2), (Pause(), FIRST + 4), (Resume(), FIRST + N))
    mine, other = ([encode(m) for m in said if isinstance(m, Scan)] for said in (ended, resumed))
    assert mine == other
    flown = [[m.states for m in said if isinstance(m, Truth)] for said in (ended, _played(name))]
    assert len(flown[0]) == len(flown[1])
    assert all(np.array_equal(one, plain) for one, plain in zip(*flown, strict=True))


def _ticked(core: EmulatorCore, from_s: float, n: int) -> list[Scan]:
    said = [message for i in range(n) for message in core.handle(Tick(from_s + i / 10.0))]
    return [message for message in said if isinstance(message, Scan)]


def _ordered(start: RunStart, k: int, *orders: Order) -> EmulatorCheckpoint:
    return checkpoint(start, k).model_copy(update={"orders": list(orders), "rate_hz": 10.0})


def test_in_real_time_the_front_end_obeys_a_pause_though_the_allocator_is_away() -> None:
    start = smoke_start(dwells=300)
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(_ordered(start, 0))
    core.handle(next(one for one in waveforms(list(_played("bins"))) if one.tracking))
    assert all(scan.bins.size for scan in _ticked(core, 0.0, 10))
    core.handle(_ordered(start, 0, Order(n=1, k=15, action=Pause())))
    faults = [scan.fault for scan in _ticked(core, 1.0, 40) if scan.k >= 15]
    assert faults == [PAUSED] * len(faults)
    assert len(faults) > 30
    assert core.trouble == ""
    assert core.measures()["dwells_not_measured"] == 0  # nothing is wrong with the front end


def test_in_real_time_an_acquisition_stands_still_in_a_pause_and_goes_on_at_once() -> None:
    """However long it lasts: a command takes effect in the dwell at which the radar stands."""
    start = smoke_start(dwells=300)
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(_ordered(start, 0, Order(n=1, k=0, action=Pause())))
    most = SMOKE.radar.acquisition.max_scans
    told = _ticked(core, 0.0, 60 * most)
    assert {scan.fault for scan in told} == {PAUSED}
    assert len(told) <= most
    k = told[-1].k + 1  # `newest_k` + 1, where no notice is given
    core.handle(_ordered(start, 0, Order(n=1, k=0, action=Pause()), Order(n=2, k=k, action=Resume())))
    (scan,) = _ticked(core, 6.0 * most, 1)
    assert (scan.k, scan.bins.size) == (k, SMOKE.radar.array.n_bin)
