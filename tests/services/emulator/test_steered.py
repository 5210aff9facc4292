"""Looks of steered cells from waveform to scan; what is no waveform or scan of such a radar is refused."""

from typing import Any

import numpy as np
import pytest

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.cycle import check_waveform, compared, scan_message, transmission
from cogradar.services.emulator.front_end import ScanData, SenselessScan, Settings
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.protocol.admission import check_scan
from cogradar.shared.protocol.messages import Refused, RunStart, Scan, Waveform
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.signal.looks import directions_everywhere
from cogradar.shared.signal.receiver import threshold
from tests.services import births
from tests.services.loop import SMOKE, checkpoint

RANGED = load("smoke", ["radar.fidelity=best-range"])
RADAR, START = RANGED.radar, RunStart.of(RANGED, Strategy.POWER_AWARE, 1, 4).model_copy(update={"run": "r"})
P_FA, CENTRES = RADAR.detector.p_fa, bin_centres(RADAR.array.n_bin)
NUS, GATES = np.array([[0.21, 0.19], [-0.3, 0.0]]), np.array([[40.0, 44.0], [0.0, 0.0]])


def _waveform(**changed: Any) -> Waveform:
    """Two beams close together for track 1, one for track 2."""
    beams = np.where([[True, True], [True, False]], angle_bin(NUS, RADAR.array.n_bin), -1).astype(np.int32)
    values: dict[str, Any] = {
        "run": "r",
        "k": 0,
        "tracking": True,
        "isotropic": 0.0,
        "factor": np.ones((RADAR.array.n_tx, 1), np.complex64) / np.float32(4),
        "beams": beams,
        "shares": np.where(beams >= 0, 1.0 / 3.0, 0.0),
        "status": "optimal",
        "late": np.zeros(2, np.int32),
        "nus": NUS,
        "gates": GATES,
    }
    return Waveform(**values | changed)


def test_beams_are_looked_at_in_their_directions_and_gates() -> None:
    asked = transmission(RADAR, _waveform())
    assert [look.nu for look in asked.looks] == [-0.3, 0.19, 0.21]
    assert [look.cells for look in asked.looks] == [range(10, 400), range(80, 88), range(80, 88)]  # of 5 .. 200 km
    assert [look.limit for look in asked.looks] == [threshold(P_FA, len(look.cells)) for look in asked.looks]
    assert asked.bins.tolist() == [look.bin for look in asked.looks] == angle_bin([-0.3, 0.19, 0.21], 16).tolist()
    steered = load("smoke", ["radar.fidelity=best"]).radar
    without_cells = transmission(steered, _waveform()).looks
    assert {(len(look.cells), look.limit) for look in without_cells} == {(0, threshold(P_FA))}


@pytest.mark.parametrize("fidelity", ["best", "best-range"])
def test_all_bins_are_looked_at_while_power_goes_everywhere(fidelity: str) -> None:
    radar = load("smoke", [f"radar.fidelity={fidelity}"]).radar
    width = radar.receiver.range_cell_km
    cells, n = (range(10, 400), 2 * 390) if width else (range(0), 1)
    for waveform in (None, _waveform(isotropic=0.5)):
        asked = transmission(radar, waveform)
        assert [look.nu for look in asked.looks] == directions_everywhere(16, width).tolist()
        assert {(look.cells, look.limit) for look in asked.looks} == {(cells, threshold(P_FA, n))}
        assert asked.bins.tolist() == list(range(16))


def test_two_tracks_that_ask_for_one_cell_share_its_look() -> None:
    same = {"nus": np.full((2, 2), 0.2), "beams": np.array([[11, -1], [11, -1]], np.int32)}
    same["beams"][:] = np.where(same["beams"] >= 0, angle_bin(0.2, 16), -1)
    shares = {"shares": np.array([[0.5, 0.0], [0.5, 0.0]])}
    gates = np.array([[40.0, 44.0], [40.0, 44.0]])
    assert len(transmission(RADAR, _waveform(**same, **shares, gates=gates)).looks) == 1
    gates[1] += 4.0
    assert [look.cells for look in transmission(RADAR, _waveform(**same, **shares, gates=gates)).looks] == [
        range(80, 88),
        range(88, 96),
    ]


def test_a_scan_says_what_was_looked_at() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    acquisition, _ = core.handle(checkpoint(START))
    assert isinstance(acquisition, Scan)
    assert acquisition.nus is not None
    assert np.abs(acquisition.nus - CENTRES).max() == pytest.approx(0.25 / 15)
    assert acquisition.bins.tolist() == list(range(16))
    scan, _ = core.handle(_waveform())
    assert isinstance(scan, Scan)
    assert scan.beam_nus is not None
    assert scan.nus is not None
    assert scan.beam_nus.tolist() == NUS.tolist()
    assert np.asarray(scan.gates).tolist() == GATES.tolist()
    assert set(scan.nus) == {-0.3, 0.19, 0.21}


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"nus": None, "gates": None}, "without directions: cells are steered"),
        ({"nus": NUS - 0.2}, "do not match their directions"),
    ],
)
def test_a_waveform_of_other_cells_is_refused(changed: dict[str, Any], reason: str) -> None:
    check_waveform(_waveform(), RADAR, 4)
    with pytest.raises(Refused, match=reason):
        check_waveform(_waveform(**changed), RADAR, 4)
    with pytest.raises(Refused, match="with directions: cells are bins"):
        check_waveform(_waveform(), SMOKE.radar, 4)


def test_a_waveform_that_lights_up_nothing_is_refused() -> None:
    """Nothing would be measured; with the search alone, or with power everywhere, there is a scan."""
    faint = {"factor": np.ones((births.UNKNOWN.radar.array.n_tx, 1), np.complex64) / np.float32(4)}
    searching = births.waveform(0, births.roster({})).model_copy(update=faint)
    check_waveform(searching, births.UNKNOWN.radar, 4)
    assert searching.roster is not None
    dark = searching.model_copy(update={"roster": searching.roster.model_copy(update={"searched": np.empty(0)})})
    with pytest.raises(Refused, match="must light up some cell"):
        check_waveform(dark, births.UNKNOWN.radar, 4)
    everywhere = {"isotropic": 0.5, "factor": np.zeros_like(faint["factor"])}
    check_waveform(dark.model_copy(update=everywhere), births.UNKNOWN.radar, 4)


def _scan(**changed: Any) -> Scan:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(checkpoint(START))
    scan, _ = core.handle(_waveform())
    assert isinstance(scan, Scan)
    return scan.model_copy(update=changed)


N = 3


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"nus": np.array([-0.3, 0.19, 0.22])}, "lacks the direction"),
        ({"nus": np.array([-0.4, 0.19, 0.21])}, "bins do not match"),
        ({"nus": np.array([-0.7, 0.19, 0.21])}, "bins do not match"),
        ({"beam_nus": NUS - 0.2}, "do not match their directions"),
        ({"limits": np.zeros(N)}, "limits must be > 0"),
        ({"ranges_km": -np.ones(N)}, "ranges and standard deviations"),
        ({"ranges_km": np.zeros(N)}, "other than radar.receiver says"),
        ({"nu_sigmas": -np.ones(N)}, "ranges and standard deviations"),
        ({"bins": np.array([3, 11, 16], np.int32)}, "scan of 3 cells up to 16"),
    ],
)
def test_a_scan_that_this_receiver_cannot_make_is_refused(changed: dict[str, Any], reason: str) -> None:
    check_scan(_scan(), RADAR)
    with pytest.raises(Refused, match=reason):
        check_scan(_scan(**changed), RADAR)


def test_a_scan_of_bins_is_none_of_steered_cells_nor_the_reverse() -> None:
    bins = dict.fromkeys(("nus", "limits", "ranges_km", "nu_hats", "nu_sigmas", "beam_nus", "gates"))
    with pytest.raises(Refused, match="without directions: cells are steered"):
        check_scan(_scan(**bins), RADAR)
    with pytest.raises(Refused, match="with directions: cells are bins"):
        check_scan(_scan(), SMOKE.radar)
    plain = load("smoke", ["radar.fidelity=best-range", "radar.receiver.monopulse=false"]).radar
    measured = _scan(nu_sigmas=np.full(N, 0.01))
    check_scan(measured, RADAR)
    with pytest.raises(Refused, match=r"other than radar\.receiver says"):
        check_scan(measured, plain)


def test_the_scan_of_a_front_end_that_forgets_the_directions_is_refused_with_the_reason() -> None:
    asked, values = transmission(RADAR, _waveform()), np.ones(N)
    data = compared(RADAR, asked, ScanData(asked.bins, values, values.astype(np.complex64), values, values))
    with pytest.raises(SenselessScan, match="must be there or not"):
        scan_message(Settings.of(checkpoint(START)), 1, 1, data, _waveform())
