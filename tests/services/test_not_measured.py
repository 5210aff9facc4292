"""Looks and dwells that a front end does not measure: beliefs coast, nobody is missed, and it is counted."""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pytest

from cogradar.services.cli.display import run_caption
from cogradar.services.emulator.front_end import FrontEnd
from cogradar.services.emulator.recorded import RecordedFrontEnd
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.planner.owned_track import detections_of
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.runs.run import result
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, Plan, RunEnd, RunStart, Scan, Truth, Waveform
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.tracking.existence import SURVIVES_S
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.wire.codec import encode
from tests.lossy import lossy
from tests.services.loop import plans, play, scans, smoke_start
from tests.skies import sky_start

DWELLS = 40
OUTAGE = range(20, 30)  # dwells k
LOSS = 0.2


def _steered() -> RunStart:
    scenario = load("smoke", ["radar.fidelity=best-range"])
    return RunStart.of(scenario, Strategy.POWER_AWARE, 1, DWELLS).model_copy(update={"run": "r"})


STARTS: dict[str, Callable[[], RunStart]] = {
    "bins": lambda: smoke_start(dwells=DWELLS),
    "orthogonal": lambda: smoke_start(Strategy.ORTHOGONAL, dwells=DWELLS),
    "steered": _steered,
    "unknown": lambda: sky_start(dwells=DWELLS),
}


@cache
def _played(name: str) -> tuple[Message, ...]:
    return tuple(play(STARTS[name](), lossy(LOSS, OUTAGE)))


def _of_loop(said: Sequence[Message]) -> list[bytes]:
    return [encode(message) for message in said if isinstance(message, Scan | Plan | Waveform | RunEnd)]


@pytest.mark.parametrize("name", STARTS)
def test_a_run_goes_on_to_its_end_whatever_is_not_measured(name: str) -> None:
    said = list(_played(name))
    (end,) = [message for message in said if isinstance(message, RunEnd)]
    assert (end.status, end.t) == ("complete", DWELLS)
    found = scans(said)
    assert [scan.k for scan in found if scan.fault] == list(OUTAGE)
    assert all(not scan.bins.size for scan in found if scan.k in OUTAGE)
    lost = sum(0 if scan.unmeasured is None else scan.unmeasured.size for scan in found if scan.k not in OUTAGE)
    asked = lost + sum(np.unique(scan.bins if scan.nus is None else scan.nus).size for scan in found)
    assert 0.1 < lost / asked < 0.3


@pytest.mark.parametrize("name", STARTS)
def test_in_an_outage_beliefs_coast_and_nothing_is_detected(name: str) -> None:
    said, dt_s = list(_played(name)), RadarConfig.model_validate(STARTS[name]().scenario["radar"]).motion.dt_s
    before, after = ({plan.target: plan for plan in plans(said) if plan.k == k} for k in (OUTAGE[0] - 1, OUTAGE[-1]))
    assert before.keys() == after.keys() > set()  # no track ends, and none begins
    for target, coasted in after.items():
        last, flown_s = before[target], len(OUTAGE) * dt_s
        moved = last.in_plane[0][::2] + flown_s * last.in_plane[0][1::2]
        spread = np.sqrt(np.trace(coasted.in_plane[1][::2, ::2]))
        assert np.hypot(*(coasted.in_plane[0][::2] - moved)) < 0.5 * spread
        assert np.trace(coasted.covariance[::2, ::2]) > np.trace(last.covariance[::2, ::2])
        assert not coasted.detected
        if last.existence is not None and coasted.existence is not None:
            assert coasted.existence >= last.existence * np.exp(-flown_s / SURVIVES_S) * 0.99
            assert last.confirmed == coasted.confirmed


@pytest.mark.parametrize("name", STARTS)
def test_a_dwell_that_fails_once_is_repeated_and_changes_nothing(name: str) -> None:
    start = STARTS[name]().model_copy(update={"dwells": 6})
    assert _of_loop(play(start, lossy(raises=(0, 3, 5)))) == _of_loop(play(start, SimulatedFrontEnd.open))


@pytest.mark.parametrize("name", STARTS)
def test_a_recording_of_it_plays_the_same_run(name: str) -> None:
    said = list(_played(name))
    payloads = {scan.k: encode(scan) for scan in scans(said)}
    start = STARTS[name]()
    blind = start.model_copy(update={"scenario": start.scenario | {"world": None}})

    def recorded(_: object) -> FrontEnd:
        return RecordedFrontEnd(payloads.get)

    assert _of_loop(play(blind, recorded)) == _of_loop(said)


def _stored(name: str, *, has_truth: bool = True) -> Store:
    store, start = in_memory(), STARTS[name]()
    if not has_truth:
        start = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    core = RecorderCore(store.journal)
    core.handle(start)
    for message in _played(name):
        if isinstance(message, Scan | Plan | Waveform | RunEnd) or (has_truth and isinstance(message, Truth)):
            core.handle(message)
    for _ in range(2):
        core.handle(Tick(0.0))
    return store


@pytest.mark.parametrize("has_truth", [True, False])
@pytest.mark.parametrize("name", STARTS)
def test_what_was_not_measured_is_counted_and_is_no_miss(name: str, has_truth: bool) -> None:
    store, start, found = _stored(name, has_truth=has_truth), STARTS[name](), scans(list(_played(name)))
    tracking = [scan for scan in found if scan.t > 0]
    (picture,) = answer(store, "picture", {})
    counts = [0 if scan.unmeasured is None else scan.unmeasured.size for scan in tracking]
    outage = {scan.t for scan in tracking if not scan.bins.size}
    assert (picture["unmeasured_looks"], picture["unmeasured_dwells"]) == (sum(counts), len(outage))
    done = result(lambda metric, asked: answer(store, metric, asked), start, began=0.0)
    assert done is not None
    caption = run_caption(done)
    assert f"not measured: {sum(counts)} looks, {len(outage)} dwells as a whole" in caption
    (fault,) = (scan.fault for scan in tracking if scan.t == max(outage))
    assert fault
    assert caption.count(f"not in P_D; the last time: {fault}") == 1
    rows = answer(store, "tracks", {})
    assert all(row["detected"] is None for row in rows if row["t"] in outage and row["track"] is not None)
    assert not rows or any(row["detected"] is not None for row in rows if row["t"] not in outage)
    for row in done.targets:
        at = [one["detected"] for one in rows if one["target"] == row["target"] and one["detected"] is not None]
        assert row["n"] <= len(at) <= DWELLS - len(OUTAGE)
        assert row["detections"] <= sum(at)


def test_an_acquisition_that_misses_a_bin_in_half_of_its_scans_takes_it_from_the_others() -> None:
    """A scan with a bin left out confirms as if that bin said nothing: its row is blank."""
    said = play(_steered(), lossy(0.5))
    first = next(scan for scan in scans(said) if scan.t == 0 and scan.unmeasured is not None)
    model = TrackerModel.of(RadarConfig.model_validate(_steered().scenario["radar"]), Strategy.POWER_AWARE, 1)
    n_bin = model.sensor.n_bin
    seen = detections_of(model, first)
    filled = seen.everywhere(n_bin)
    assert np.array_equal(filled.bins, np.arange(n_bin))
    is_new = ~np.isin(filled.bins, first.bins)
    assert is_new.sum() == n_bin - first.bins.size > 0
    assert not filled.sigma_hat[is_new].any()
    assert not filled.is_over()[is_new].any()
    for name in ("statistic", "alpha_hat", "sigma_hat", "signature_power", "nus", "limits", "ranges_km", "nu_hats"):
        assert np.array_equal(getattr(filled, name)[~is_new], getattr(seen, name))
    (end,) = [message for message in said if isinstance(message, RunEnd)]
    assert end.status == "complete"


@pytest.mark.parametrize("name", ["bins", "orthogonal"])
def test_a_track_is_not_lost_because_nothing_was_measured(name: str) -> None:
    """Asked for the outage alone, or for it and dwells before it, in all of which the track was in its bin."""
    store = _stored(name)
    for first, last in ((OUTAGE[0], OUTAGE[-1]), (OUTAGE[0] - 5, OUTAGE[0] + 2)):
        tracks = answer(store, "tracks", {"dwells": f"{first}:{last}"})
        in_bin = {row["target"] for row in tracks} - {row["target"] for row in tracks if row["outage"]}
        for row in answer(store, "summary", {"dwells": f"{first}:{last}"}):
            assert row["target"] not in in_bin or row["lost"] is False
        assert in_bin
