"""Messages check themselves when they are made, so that no process computes with nonsense."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cogradar.shared.protocol.fields import MAX_PARTICLES, MAX_SIDE
from cogradar.shared.protocol.messages import (
    MAX_FAULT,
    EmulatorCheckpoint,
    Message,
    Plan,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from cogradar.shared.protocol.recovery import ScanRecall, Snapshot
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode, encode, fields
from tests.samples import BEAMS, BINS, EXCHANGED, FIELDS, ROW, SMOKE, asked, plan, sample

I4, C8 = np.int32, np.complex64
ZEROS = np.zeros((2, 2))


@pytest.mark.parametrize("kind", FIELDS | EXCHANGED, ids=lambda kind: kind.__name__)
def test_messages_are_frozen_complete_and_known_to_the_key(kind: type[Message]) -> None:
    message = sample(kind)
    with pytest.raises(ValidationError, match="frozen"):
        message.run = "other"
    with pytest.raises(ValidationError, match="Extra inputs"):
        sample(kind, more=1)
    for run in ("", "a/b", "*", "a b", "-a", "a\n", "a" * 65, "é", 1):
        with pytest.raises(ValidationError):
            sample(kind, run=run)


@pytest.mark.parametrize(
    ("kind", "changed", "reason"),
    [
        (RunStart, {"seed": -1}, "greater than or equal to 0"),
        (RunStart, {"seed": 2**63}, "less than"),
        (RunStart, {"dwells": 0}, "greater than or equal to 1"),
        (RunStart, {"strategy": "random"}, "'orthogonal', 'uniform' or 'power-aware'"),
        (RunStart, {"scenario": {**SMOKE, "dwells": 0}}, "scenario: dwells = 0: must be an integer >= 1"),
        (Scan, {"k": -1}, "greater than or equal to 0"),
        (Scan, {"k": True}, "valid integer"),
        (Scan, {"statistic": ROW[:2]}, "must have one length"),
        (Scan, {"bins": BINS[::-1].copy()}, "or else nus, ascending"),
        (Scan, {"bins": np.array([2, 2, 9], I4)}, "or else nus, ascending"),
        (Scan, {"bins": np.array([-1, 5, 9], I4)}, "from 0"),
        (Scan, {n: FIELDS[Scan][n][:0] for n in FIELDS[Scan] if n not in ("k", "t")}, "at least one"),
        (Scan, {"unmeasured": np.empty(0)}, "unmeasured must be directions, -0.5 .. 0.5, at least one, ascending"),
        (Scan, {"unmeasured": np.array([0.6])}, "unmeasured must be directions"),
        (Scan, {"unmeasured": np.array([0.2, 0.1])}, "at least one, ascending"),
        (Scan, {"fault": "no packet"}, "without a fault, unless something is unmeasured"),
        (Scan, {"unmeasured": np.array([0.1]), "fault": "x" * (MAX_FAULT + 1)}, "at most 200 characters"),
        (Scan, {"beams": np.array([[5], [6]], I4)}, "every beam must be one of bins, or -1"),
        (Scan, {"beams": np.array([[5, -2]], I4)}, "every beam must be one of bins, or -1"),
        (Scan, {"beams": np.array([[-1, 5], [9, -1]], I4)}, "-1 must be behind the last cell of a row"),
        (Scan, {"beams": np.array([[5, 9, 5], [9, -1, -1]], I4)}, "the cells of a track must all be different"),
        (Scan, {"beams": np.full((2, 1025), 5, I4)}, "must have 1 .. 1024 columns, got 1025"),
        (Scan, {"beams": np.empty((2, 0), I4)}, "must have 1 .. 1024 columns, got 0"),
        (Scan, {"statistic": ROW.tolist()}, "must be an array of float64"),
        (Scan, {"statistic": ROW.astype(np.float32)}, "must be an array of float64"),
        (Scan, {"statistic": ROW[:, None]}, "must have 1 axes"),
        (Scan, {"statistic": np.array([1.0, np.nan, 1.0])}, "must be finite"),
        (Scan, {"alpha_hat": np.array([1.0, np.inf, 1.0], C8)}, "must be finite"),
        (Scan, {"statistic": np.zeros(MAX_SIDE + 1)}, f"at most {MAX_SIDE}"),
        (Truth, {"states": np.ones((3, 4))}, "states must be"),
        (Truth, {"states": np.ones((2, 3))}, "states must be"),
        (Truth, {"snr_db": np.ones(3)}, "snr_db"),
        (Plan, {"bins": np.empty(0, I4)}, "best_bin must be given while tracking"),
        (Plan, {"best_bin": -1}, "best_bin must be given while tracking"),
        (Plan, {"status": "searching"}, "not while searching"),
        (Plan, {"chances": np.ones(2)}, "as many chances"),
        (Plan, asked(5, 6, 7, 8), "at most 3 bins, 0"),
        (Plan, asked(5, 5), "must all be different"),
        (Plan, {"bins": np.array([-1], I4)}, "at most 3 bins, 0 .."),
        (Plan, {"chances": np.array([1.1])}, "must be 0 .. 1"),
        (Plan, {"gain": -1.0}, "greater than or equal to 0"),
        (Plan, {"status": "lost"}, "'searching', 'tracking' or 'ended'"),
        (Plan, {"estimate": np.ones(3)}, "must be one state"),
        (Plan, {"covariance": np.eye(3)}, "must be (4, 4)"),
        (Plan, {"covariance": np.full((4, 4), 1e19)}, "within 1e+18"),
        (Plan, {"covariance": np.triu(np.ones((4, 4)))}, "must be symmetric"),
        (Plan, {"covariance": -np.eye(4)}, "variances of 0 or more"),
        (Plan, {"range_km": -1.0}, "greater than or equal to 0"),
        (Plan, {"range_km": float("inf")}, "finite"),
        (Waveform, {"shares": np.ones((2, 2))}, "beams and shares must have one shape"),
        (Waveform, {"late": np.zeros(3, I4)}, "a row for each of late"),
        (Waveform, {"tracking": False}, "all -1 during acquisition"),
        (Waveform, {"beams": np.array([[-1], [-1]], I4)}, "some beams must be >= 0 while tracking"),
        (Waveform, {"beams": np.array([[5], [-2]], I4)}, "some beams must be >= 0 while tracking"),
        (Waveform, {"beams": np.array([[3, 3], [-1, -1]], I4), "shares": ZEROS}, "must all be different"),
        (Waveform, {"beams": np.array([[-1, 3], [4, -1]], I4), "shares": ZEROS}, "behind the last cell"),
        (Waveform, {"shares": np.array([[-5.0], [0.2]])}, "shares must be >= 0"),
        (Waveform, {"beams": np.array([[5], [-1]], I4)}, "0 where no cell is lit"),
        (Waveform, {"isotropic": -0.1}, "greater than or equal to 0"),
        (Waveform, {"factor": np.ones(16, C8)}, "must have 2 axes"),
        (Snapshot, {"belief": np.ones((0, 4)), "remembered": np.ones((0, 4))}, "belief must have numbers"),
        (Snapshot, {"remembered": np.ones((4, 4))}, "remembered be (n, 4) or (0, 4)"),
        (Snapshot, {"belief": np.ones((MAX_PARTICLES + 1, 4))}, f"at most {MAX_PARTICLES}"),
        (Snapshot, {"belief": np.full((5, 4), np.nan)}, "must be finite"),
        (Snapshot, {"measured": np.zeros(3)}, "measured must be (4,)"),
        (Snapshot, {"modes": np.full(2, 0.5)}, "modes must be (3,)"),
        (Snapshot, {"looked": np.full((1, 3), np.inf)}, "must be finite"),
        (Snapshot, {"sigma_hat": 0.0}, "needs a sigma_hat > 0"),
        (Snapshot, {"log_evidence": float("nan")}, "finite"),
        (ScanRecall, {"targets": []}, "at least 1 item"),
        (RunEnd, {"status": "ok"}, "'stopped' or 'failed'"),
        (RunEnd, {"reason": "x" * 501}, "at most 500"),
    ],
)
def test_nonsense_is_refused(kind: type[Message], changed: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError) as caught:
        sample(kind, **changed)
    assert reason in str(caught.value)


def test_a_start_carries_the_whole_scenario_whatever_was_left_out() -> None:
    short = {key: value for key, value in SMOKE["radar"]["belief"].items() if key != "kernel_bandwidth"}
    radar = {**SMOKE["radar"], "belief": short}
    start = RunStart(run="r", scenario={**SMOKE, "radar": radar}, strategy=Strategy.UNIFORM, seed=0, dwells=1)
    assert start.scenario == SMOKE
    assert list(start.scenario) == list(SMOKE)


def test_acquisition_has_no_beams() -> None:
    none = np.array([[-1], [-1]], I4)
    assert isinstance(sample(Scan, beams=none), Scan)
    dark = {"beams": none, "shares": np.zeros((2, 1)), "tracking": False}
    assert isinstance(sample(Waveform, **dark, status="acquisition"), Waveform)
    assert Plan(run="r", k=0, t=0, target=0, status="searching").bins.size == 0


@pytest.mark.parametrize("kind", FIELDS | EXCHANGED, ids=lambda kind: kind.__name__)
def test_equal_messages_are_equal_and_hash_alike(kind: type[Message]) -> None:
    assert sample(kind) == sample(kind)
    assert hash(sample(kind)) == hash(sample(kind))
    assert sample(kind) != sample(kind, run="other")
    assert sample(kind) != "something else"


def test_equality_is_bit_for_bit() -> None:
    zero, minus = plan(estimate=np.zeros(4)), plan(estimate=-np.zeros(4))
    assert zero != minus
    assert plan(range_km=0.0) != plan(range_km=-0.0)
    assert sample(Scan, beams=BEAMS) != sample(Scan, beams=BEAMS[:1])


STEERED = {"beam_nus": np.zeros((2, 1)), "gates": np.zeros((2, 2))}
COLUMNS = {name: np.zeros(len(BINS)) for name in ("limits", "ranges_km", "nu_hats", "nu_sigmas")}


def test_a_scan_of_steered_cells_may_have_several_rows_of_a_direction() -> None:
    scan = sample(Scan, nus=np.zeros(len(BINS)), **COLUMNS, **STEERED)
    assert decode(encode(scan)) == scan
    assert "nus" not in fields(encode(sample(Scan)))  # what is not there is not sent


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (COLUMNS | STEERED, "must be there or not"),
        ({"nus": np.zeros(len(BINS))} | COLUMNS, "must be there or not"),
        ({"nus": -np.arange(len(BINS), dtype=float)} | COLUMNS | STEERED, "ascending"),
        ({"nus": np.zeros(1)} | COLUMNS | STEERED, "one length"),
        ({"nus": np.zeros(len(BINS))} | COLUMNS | STEERED | {"beam_nus": np.full((2, 1), 0.6)}, "-0.5 .. 0.5"),
        (
            {"nus": np.zeros(len(BINS))} | COLUMNS | STEERED | {"gates": np.array([[2.0, 1.0], [0.0, 0.0]])},
            "low <= high",
        ),
    ],
)
def test_steered_nonsense_is_refused(changed: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        sample(Scan, **changed)


def test_a_world_is_checked_once_and_one_of_other_types_again() -> None:
    """A checkpoint of each dwell says the whole world; what only compares equal was never checked."""
    world = deepcopy(SMOKE["world"])
    first, again = (decode(encode(sample(EmulatorCheckpoint, world=world, k=k))) for k in (1, 2))
    assert isinstance(first, EmulatorCheckpoint)
    assert isinstance(again, EmulatorCheckpoint)
    assert first.world == world
    assert again.world is first.world
    world["targets"][0]["born_s"] = False
    assert world == first.world
    with pytest.raises(ValidationError, match="born_s = False"):
        sample(EmulatorCheckpoint, world=world)
