"""What mutants have found, each by itself."""

from typing import Literal

import numpy as np
import pytest

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner import owned_track
from cogradar.services.planner.core import PlannerCore
from cogradar.shared.power.looks import detections
from cogradar.shared.power.rules import Requests
from cogradar.shared.protocol.fields import FAR
from cogradar.shared.protocol.messages import Message, Plan, Refused, Scan
from cogradar.shared.protocol.recovery import History, Snapshot
from cogradar.shared.scenario.files import load
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.wire.codec import BadMessage, decode, encode
from tests.samples import ROW, sample
from tests.services.loop import checkpoint, play, scans, smoke_start, waveforms

START = smoke_start()


@pytest.fixture(scope="module")
def said() -> list[Message]:
    return play(START)


def _history(topic: Literal["scan", "waveform"], to: str, *messages: Message) -> History:
    return History(run=START.run, to=to, topic=topic, k=0, payloads=[encode(message) for message in messages])


def test_waveforms_that_are_recalled_with_a_bad_one_are_all_refused(said: list[Message]) -> None:
    """The dwells of those before it were transmitted, and their scans never sent."""
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(checkpoint(START))
    first, second = waveforms(said)[:2]
    with pytest.raises(Refused, match="power"):
        core.handle(_history("waveform", "emulator", first, second.model_copy(update={"isotropic": 2.0})))
    scan = next(iter(core.handle(first)))
    assert scan == scans(said)[1]


def test_scans_that_are_recalled_with_a_bad_one_are_all_refused(said: list[Message]) -> None:
    core = PlannerCore("p")
    core.handle(checkpoint(START))
    first, second = scans(said)[:2]
    with pytest.raises(Refused, match="of a run that ends by"):
        list(core.handle(_history("scan", "p", first, second.model_copy(update={"k": 10**6}))))
    plans = [answer for answer in core.handle(second) if isinstance(answer, Plan)]
    assert plans == []  # it lacks the first one


def test_a_checkpoint_beyond_the_end_of_its_run_is_refused() -> None:
    with pytest.raises(Refused, match="checkpoint 9 of 4 dwells at t = 5"):
        EmulatorCore(SimulatedFrontEnd.open).handle(checkpoint(START, 9, 5))


@pytest.mark.parametrize("extreme", [1e308, 1e-308])
def test_numbers_whose_squares_are_none_are_dropped(extreme: float) -> None:
    """A planner ended with an OverflowError, or with a plan that is no message."""
    for bad in (
        sample(Scan).model_copy(update={"sigma_hat": np.full_like(ROW, extreme)}),
        sample(Snapshot).model_copy(update={"sigma_hat": extreme}),
        sample(Snapshot).model_copy(update={"power": extreme}),
    ):
        with pytest.raises(BadMessage, match=r"1e-60|at most 1e\+60|less than or equal to 10{60}$"):
            decode(encode(bad))


def test_a_track_that_flies_away_ends_no_planner(said: list[Message]) -> None:
    core = PlannerCore("p")
    core.handle(checkpoint(START))
    heard = scans(said)
    for scan in heard[:-2]:
        list(core.handle(scan))
    track = core._runs[START.run]._tracks[0]
    away = np.full_like(track.state.belief.rows, FAR)
    track.state = track.state._replace(belief=Particles(away))
    plans = [answer for scan in heard[-2:] for answer in core.handle(scan) if isinstance(answer, Plan)]
    assert {plan.target for plan in plans} == {0, 1}
    for plan in plans:
        decode(encode(plan))


def test_a_track_that_flies_away_leaves_no_snapshot(said: list[Message], monkeypatch: pytest.MonkeyPatch) -> None:
    """A planner ended when it was to make one."""
    monkeypatch.setattr(owned_track, "SNAPSHOT_DWELLS", 5)
    core = PlannerCore("p")
    core.handle(checkpoint(START))
    heard = scans(said)
    for scan in heard[:-2]:
        list(core.handle(scan))
    track = core._runs[START.run]._tracks[0]
    away = np.full_like(track.state.belief.rows, 2 * FAR)
    track.state = track.state._replace(belief=Particles(away))
    plans = [answer for scan in heard[-2:] for answer in core.handle(scan) if isinstance(answer, Plan)]
    assert {plan.target for plan in plans} == {0, 1}
    answers = [message for k in range(len(heard) + 1) for message in core.handle(checkpoint(START, k, k))]
    assert {m.target for m in answers if isinstance(m, Snapshot)} == {1}


def test_tracks_stay_dark_if_the_search_has_taken_all_power() -> None:
    """An allocator ended with a ValueError."""
    radar = load("smoke", ["radar.fidelity=best"]).radar
    radar = radar.model_copy(update={"array": radar.array.model_copy(update={"power": 0.0})})
    one = np.ones(1)
    sent = detections(radar, Requests(np.array([[0.2]]), np.ones((1, 1)), one, one, one, np.array([1]), one > 0.0))
    assert np.isnan(sent.nus).tolist() == [[True]]
    assert sent.shares.tolist() == [[0.0]]
