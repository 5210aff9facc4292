"""Targets at a height: what is scored of them is where the array measures them, errors are those on the ground."""

import json

import numpy as np
import pytest

from cogradar.services.analysis.arrays.result import Result as Arrays
from cogradar.services.analysis.export.tables import scores
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs.in_process import play
from cogradar.services.runs.run import Result
from cogradar.services.web.views.dwells import Encoded, between
from cogradar.services.web.views.radar import facts
from cogradar.shared.protocol.messages import RunStart, Truth
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode

DWELLS, HEIGHT_KM = 10, 15.0
# Strong echoes: each is detected in each dwell, with few false alarms. 3 km, that is six range cells, and 1.5 bins of
# difference between the position in space and the one on the ground.
HIGH = f"""world.targets=[
 {{state=[40.0, 0.1, -30.0, 0.05], height_km={HEIGHT_KM}, sigma_s_km_s2=0.0, rcs_db=20.0}},
 {{trajectory=[[-5.0, 30.0, 20.0, 15.0], [60.0, 33.0, 21.0, 12.0]], rcs_db=20.0}}]""".replace("\n", "")


@pytest.fixture(scope="module", params=["cells", "array"])
def played(request: pytest.FixtureRequest) -> tuple[Store, Result]:
    settings = [HIGH, "radar.fidelity=best-range", "radar.detector.p_fa=1e-6", f"world.signal={request.param}"]
    store = in_memory()
    return store, play(RunStart.of(load("smoke", settings), Strategy.ORTHOGONAL, 1, DWELLS), store=store)


def arrays_of(store: Store, result: Result) -> Arrays:
    return Arrays(StoredRun(lambda metric, asked: answer(store, metric, asked), result.run["run"]))


def test_a_detection_at_the_measured_range_and_direction_is_of_its_target(played: tuple[Store, Result]) -> None:
    store, result = played
    assert min(row["p_d"] for row in answer(store, "p_d", {})) >= 0.8
    arrays = arrays_of(store, result)
    slant = np.sqrt(arrays.true_states[..., 0] ** 2 + arrays.true_states[..., 2] ** 2 + arrays.heights_km**2)
    assert np.nanmax(np.abs(arrays.measured.range_km - slant)) < 0.26
    assert set(arrays.detections()["target"].tolist()) >= {1, 2}
    known = facts(store, result.run["run"])
    dwells = [json.loads(data) for _, data in between(store, known, Encoded(), 1, DWELLS, DWELLS)]
    found = [[target["statistic"] for target in dwell["targets"]] for dwell in dwells]
    np.testing.assert_array_equal(np.array(found, np.float64), arrays.measured.statistic)


def test_heights_are_in_truth_scores_and_exports(played: tuple[Store, Result]) -> None:
    store, result = played
    truths = [decode(payload) for payload in store.journal.messages(result.run["run"], ("truth",))]
    seen = {truth.t: truth for truth in truths if isinstance(truth, Truth)}
    for t in range(1, DWELLS + 1):
        assert seen[t].heights_km == pytest.approx([HEIGHT_KM, 15.0 - (t + 5.0) * 3.0 / 65.0])
    exported = scores(arrays_of(store, result))
    assert exported["z"][::2] == pytest.approx(np.full(DWELLS, HEIGHT_KM))
    with pytest.raises(ValueError, match="states must be 0"):
        Truth.model_validate(
            {**vars(seen[1]), "bins": np.full(2, -1, np.int32), "states": np.zeros((2, 4)), "snr_db": np.zeros(2)}
        )


@pytest.mark.parametrize(("assumed_km", "least", "most"), [(20.0, 0.5, 12.0), (0.0, 100.0, np.inf)])
def test_estimates_on_the_ground_say_what_heights_leave_unknown(assumed_km: float, least: float, most: float) -> None:
    """Of the same two targets, 12 to 15 km high; without the assumption errors are far beyond what is said of them."""
    settings = [HIGH, "radar.fidelity=best-range", "radar.detector.p_fa=1e-6"]
    store, radar = in_memory(), [f"radar.assumes.height_max_km={assumed_km}"]
    result = play(RunStart.of(load("smoke", [*settings, *radar]), Strategy.ORTHOGONAL, 1, DWELLS), store=store)
    nees = np.asarray(arrays_of(store, result).nees)
    assert least < np.nanmean(nees) < most


def test_the_allocator_and_the_search_stay_in_the_plane_of_the_array() -> None:
    """An unknown number, 10 km high, is followed as well as at height 0: the roster expects what is measured."""
    flying = "world.targets=[{state=[40.0, -0.1, -10.0, 0.1], rcs_db=20.0, height_km=HEIGHT}]"
    shares = []
    for height in (0.0, 10.0):
        settings = [flying.replace("HEIGHT", str(height)), "radar.fidelity=best-range", 'radar.tracks="unknown"']
        store = in_memory()
        start = RunStart.of(load("smoke", [*settings, "radar.assumes.height_max_km=12"]), Strategy.POWER_AWARE, 1, 20)
        result = play(start, store=store)
        shares.append(np.mean(np.isfinite(np.asarray(arrays_of(store, result).estimates)[..., 0])))
    assert shares[0] == pytest.approx(shares[1], abs=0.1)
    assert min(shares) > 0.7
