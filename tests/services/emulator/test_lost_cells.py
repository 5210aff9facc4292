"""Range cells that were not received: what is measured is decided by what came, never by what was found in it."""

from collections.abc import Iterable

import numpy as np
import pytest

from cogradar.front_end import ScanData, root, steering_vector
from cogradar.services.emulator.cycle import compared, scan_message, transmission
from cogradar.services.emulator.front_end import SenselessScan, Settings, Transmission, receive
from cogradar.services.planner.owned_track import detections_of
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Scan, Waveform
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.array import angle_bin
from cogradar.shared.tracking.acquisition import Candidates
from cogradar.shared.tracking.association import associate
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.track import coast, observe, start
from tests.services.loop import checkpoint, smoke_start

DOCUMENT = load("smoke").radar.model_dump(mode="json")
RADAR = RadarConfig.model_validate(
    DOCUMENT | {"receiver": DOCUMENT["receiver"] | {"cells": "steered", "range_cell_km": 1.0}}
)
MODEL = TrackerModel.of(RADAR, Strategy.POWER_AWARE, 1)
NU, CELL = 0.2, 30
N = RADAR.array.n_tx, RADAR.array.n_rx


def _data(asked: Transmission, lost: Iterable[int], seed: int = 1) -> dict[int, np.ndarray]:
    """Noise in all cells, a strong echo in one, and nothing of those that are lost."""
    w, data = root(asked.isotropic, asked.factor), {}
    for cell in set(asked.range_cells) - set(lost):
        re, im = np.random.default_rng((seed, cell)).standard_normal((2, *N)) / np.sqrt(2.0)
        echo = 3.0 * np.outer(w.T @ steering_vector(NU, N[0]), steering_vector(NU, N[1]))
        data[cell] = re + 1j * im + (cell == CELL) * echo
    return data


def _scan(asked: Transmission, waveform: Waveform | None, lost: Iterable[int], seed: int = 1) -> Scan:
    settings = Settings.of(_checkpoint())
    measured = compared(RADAR, asked, receive(_data(asked, lost, seed), asked, RADAR))
    return scan_message(settings, 0 if waveform is None else 1, 0 if waveform is None else 1, measured, waveform)


def _checkpoint() -> EmulatorCheckpoint:
    return checkpoint(smoke_start()).model_copy(update={"world": None, "radar": RADAR.model_dump()})


def _beams(gates: list[list[float]]) -> Waveform:
    nus = np.array([[NU], [-0.3]])
    return Waveform(
        run="r",
        k=0,
        tracking=True,
        isotropic=0.0,
        factor=(0.1 * np.stack([steering_vector(float(nu), N[0]) for nu in nus[:, 0]], 1).conj()).astype(np.complex64),
        beams=np.array(angle_bin(nus, RADAR.array.n_bin).astype(np.int32), np.int32),
        shares=np.full((2, 1), 0.5),
        status="fixed",
        late=np.zeros(2, np.int32),
        nus=nus,
        gates=np.array(gates),
    )


@pytest.mark.parametrize("lost", [CELL - 2, CELL + 2])
def test_a_look_that_is_incomplete_is_not_measured_whether_it_detects_or_not(lost: int) -> None:
    waveform = _beams([[28.0, 33.0], [40.0, 45.0]])
    asked = transmission(RADAR, waveform)
    whole, cut = _scan(asked, waveform, ()), _scan(asked, waveform, [lost])
    assert whole.nus is not None
    assert cut.nus is not None
    assert (whole.lost_km, whole.unmeasured) == (None, None)
    assert NU in whole.nus[whole.statistic >= np.asarray(whole.limits)]  # the echo is received in both
    assert cut.unmeasured is not None
    assert (set(cut.nus.tolist()), cut.unmeasured.tolist()) == ({-0.3}, [NU])
    assert cut.lost_km is not None
    assert cut.lost_km.tolist() == [lost + 0.5]


def test_an_acquisition_is_silent_of_the_range_cells_that_were_lost_alone() -> None:
    """A miss would outweigh the scans in which the target was found."""
    asked = transmission(RADAR, None)
    scans = [detections_of(MODEL, _scan(asked, None, lost, i)) for i, lost in enumerate([(), [CELL], [CELL, 100]])]
    assert [scan.bins.size for scan in scans] == [RADAR.array.n_bin] * 3
    assert [None if scan.lost_km is None else scan.lost_km.tolist() for scan in scans] == [None, [30.5], [30.5, 100.5]]
    row = int(angle_bin(NU, RADAR.array.n_bin))
    assert scans[0].ranges_km[row] == CELL + 0.5
    odds = [_odds(Candidates(MODEL, scans[: n + 1]), row) for n in range(3)]
    assert odds == [odds[0]] * 3
    missed = scans[1]._replace(lost_km=None)
    assert _odds(Candidates(MODEL, [scans[0], missed]), row) < odds[0] - 3.0


def _odds(candidates: Candidates, row: int) -> float:
    where, rows = candidates._positions
    (at,) = np.flatnonzero((rows == row) & (where[:, 1] == CELL + 0.5))
    return float(candidates.log_odds[at])


def test_a_scan_cannot_say_what_it_has_lost_without_range_cells() -> None:
    radar = load("smoke").radar
    asked = transmission(radar, None)
    ones = np.ones(radar.array.n_bin)
    measured = ScanData(asked.bins, ones, ones.astype(np.complex64), ones, ones, lost_km=np.array([30.5]))
    settings = Settings.of(_checkpoint().model_copy(update={"radar": radar.model_dump()}))
    with pytest.raises(SenselessScan, match="lost range cells, there are none"):
        scan_message(settings, 0, 0, compared(radar, asked, measured), None)


def test_a_track_in_a_range_cell_that_was_lost_coasts_and_others_do_not() -> None:
    asked, bin_ = transmission(RADAR, None), int(angle_bin(NU, RADAR.array.n_bin))
    first = detections_of(MODEL, _scan(asked, None, ()))
    tracked = start(MODEL, 0, bin_, [first], CELL + 0.5)
    for lost, is_seen in ([CELL], False), ([100], True):
        scan = detections_of(MODEL, _scan(asked, None, lost))._replace(k=1)
        assert associate(MODEL, tracked, scan).is_looked == is_seen
        after = observe(MODEL, tracked, scan)
        coasted = coast(MODEL, tracked, 2)
        assert np.array_equal(after.belief.sample(), coasted.belief.sample()) != is_seen


def test_a_target_whose_look_was_not_measured_counts_neither_way() -> None:
    """Another look may have found it: that one is not always there when this one is."""
    waveform = _beams([[28.0, 33.0], [40.0, 45.0]])
    rows = ScanRows.of(RADAR)
    x, y = (CELL + 0.5) * np.sqrt(1.0 - 4.0 * NU**2), (CELL + 0.5) * 2.0 * NU
    states = np.array([[x, 0.0, y, 0.0]])
    whole = detections_of(MODEL, _scan(transmission(RADAR, waveform), waveform, ()))
    assert rows.seen(whole, states, [-1])[0].tolist() == [True]
    assert rows.misses_looks(whole, states).tolist() == [False]
    assert rows.misses_looks(whole._replace(unmeasured=np.array([NU + 1e-3])), states).tolist() == [True]
    assert rows.misses_looks(whole._replace(lost_km=np.array([CELL + 0.5])), states).tolist() == [True]
    assert rows.misses_looks(whole._replace(lost_km=np.array([CELL + 1.5])), states).tolist() == [False]


def test_two_looks_of_one_direction_have_each_their_own_range_cells() -> None:
    waveform = _beams([[28.0, 33.0], [40.0, 45.0]])
    waveform = waveform.model_copy(
        update={"nus": np.array([[NU], [NU]]), "beams": np.repeat(waveform.beams[:1], 2, axis=0)}
    )
    scan = _scan(transmission(RADAR, waveform), waveform, range(40, 45))
    assert scan.unmeasured is not None
    assert scan.unmeasured.tolist() == [NU]
    assert {CELL + 0.5} <= set(np.asarray(scan.ranges_km).tolist()) < {i + 0.5 for i in range(28, 33)}


def test_a_track_that_was_not_lit_is_not_unmeasured() -> None:
    """The directions of its beams are 0, which may be one of those that were not measured."""
    waveform = _beams([[28.0, 33.0], [40.0, 45.0]])
    scan = detections_of(MODEL, _scan(transmission(RADAR, waveform), waveform, ()))
    scan = scan._replace(beams=np.array([[10], [-1]]), beam_nus=np.array([[NU], [0.0]]), unmeasured=np.array([0.0]))
    assert [scan.is_unmeasured(at) for at in (0, 1)] == [False, False]
    assert scan._replace(unmeasured=np.array([NU])).is_unmeasured(0)
