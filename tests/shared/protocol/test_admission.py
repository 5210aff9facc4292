"""Which scans of tracks of an unknown number make sense."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cogradar.shared.protocol.admission import check_plan, check_roster, check_scan, check_track
from cogradar.shared.protocol.messages import Plan, Refused, Scan
from cogradar.shared.protocol.roster import EXPECTED, Roster
from cogradar.shared.signal.array import bin_centres
from tests.samples import BINS, sample
from tests.services.births import FAR, HERE, THERE, UNKNOWN, plan, roster, scan
from tests.services.loop import SMOKE

NONE, TWO = roster({}), roster({0: HERE, 1: THERE})
RADAR = UNKNOWN.radar


@pytest.mark.parametrize("sent", [scan(0, NONE), scan(3, NONE), scan(3, TWO), scan(3, TWO, over=[HERE])])
def test_beams_the_search_or_all_bins_are_tested(sent: Scan) -> None:
    """There may be no track; the first dwell, and one with power everywhere, have all bins."""
    check_scan(sent, RADAR)
    everywhere = scan(0, NONE).model_copy(update={"k": 9, "t": 10})
    check_scan(everywhere, RADAR)


REFUSED = {
    "the clock stood still": (scan(3, TWO).model_copy(update={"t": 3}), "scan of dwell 3 at t = 3"),
    "nobody asked": (scan(3, TWO, over=[FAR]), "scan of dwell 3 with cells other than its beams"),
    "the first has all bins": (scan(1, NONE).model_copy(update={"k": 0, "t": 1}), "scan of dwell 0 with cells"),
    "no roster": (scan(3, TWO).model_copy(update={"roster": None}), "without roster: .*tracks = unknown"),
}


@pytest.mark.parametrize(("sent", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_what_makes_no_sense_is_refused(sent: Scan, words: str) -> None:
    with pytest.raises(Refused, match=words):
        check_scan(sent, RADAR)


COLUMNS = ("bins", "statistic", "alpha_hat", "sigma_hat", "signature_power")


def _without(sent: Scan, *rows: int) -> Scan:
    """A scan in which the looks of these rows were not measured."""
    nus, names = np.asarray(sent.nus), (*COLUMNS, *Scan.PARTS["directions"][:5])
    unmeasured = np.unique(nus[list(rows)])
    cut = {name: getattr(sent, name)[~np.isin(nus, unmeasured)] for name in names}
    return Scan.model_validate(vars(sent) | cut | {"unmeasured": unmeasured})


@pytest.mark.parametrize("sent", [scan(0, NONE), scan(3, NONE), scan(3, TWO), scan(3, TWO, over=[HERE])])
def test_what_was_asked_for_may_be_left_out_of_a_scan_and_nothing_else(sent: Scan) -> None:
    n = sent.bins.size
    check_scan(_without(sent, 0), RADAR)
    check_scan(_without(sent, *range(n)), RADAR)
    strange = _without(sent, 0).model_copy(update={"k": 3, "t": 4, "unmeasured": np.array([0.123])})
    with pytest.raises(Refused, match=r"neither measured nor unmeasured|lacks the direction|cells other than"):
        check_scan(strange, RADAR)


def test_an_acquisition_has_each_bin_measured_or_not() -> None:
    n_bin = SMOKE.radar.array.n_bin
    whole = sample(Scan, t=0, beams=np.full((2, 1), -1, np.int32), unmeasured=np.delete(bin_centres(n_bin), BINS))
    assert isinstance(whole, Scan)
    check_scan(whole, SMOKE.radar)
    with pytest.raises(Refused, match="scan of 15 cells"):
        check_scan(whole.model_copy(update={"unmeasured": np.asarray(whole.unmeasured)[1:]}), SMOKE.radar)
    with pytest.raises(Refused, match="scan of 3 cells"):
        check_scan(whole.model_copy(update={"unmeasured": None}), SMOKE.radar)


def test_a_beam_is_measured_or_not() -> None:
    sent = sample(Scan, t=1, unmeasured=bin_centres(SMOKE.radar.array.n_bin)[[3]], beams=np.array([[5], [3]], np.int32))
    assert isinstance(sent, Scan)
    check_scan(sent, SMOKE.radar)
    with pytest.raises(Refused, match="a beam is neither measured nor unmeasured"):
        check_scan(sent.model_copy(update={"beams": np.array([[5], [4]], np.int32)}), SMOKE.radar)


def test_a_known_number_has_no_tracks_that_begin() -> None:
    with pytest.raises(Refused, match=r"with directions: .*tracks = 2"):
        check_scan(scan(3, TWO), SMOKE.radar)


@pytest.mark.parametrize(("track", "k"), [(0, 1), (4, 1), (5, 2), (14, 3)])
def test_so_many_tracks_may_have_begun(track: int, k: int) -> None:
    """At most max_tracks = 5 with each dwell before."""
    check_track(track, k, RADAR)
    with pytest.raises(Refused, match=f"track {5 * k} in dwell {k}, there can be {5 * k}"):
        check_track(5 * k, k, RADAR)


BORN = roster({0: HERE, 1: THERE}, born=[1], born_k=2)


def _column(name: str, column: int, value: float) -> dict[str, Any]:
    rows = getattr(BORN, name).copy()
    rows[-1, column] = value
    return {name: rows}


NO_ROSTER = [
    *(_column("births", column, 0.6) for column in (0, 3)),
    *(_column("births", column, 0.0) for column in (1, 6, 7)),
    *(_column("births", column, -1.0) for column in (2, 4, 5)),
    *(_column("expected", column, -1.0) for column in range(EXPECTED)),
    _column("expected", 4, 1.1),
    _column("births", 2, 2e9),
    _column("expected", 2, 2e9),
    {"confirmed": np.array([1, 2], np.int32)},
    {"born_k": np.array([-1, 2], np.int32)},
    {"born_k": np.array([3, 2], np.int32)},
]


@pytest.mark.parametrize("changed", NO_ROSTER)
def test_a_roster_of_values_that_cannot_be_is_none(changed: dict[str, Any]) -> None:
    values = {name: getattr(BORN, name) for name in Roster.model_fields}
    assert Roster.model_validate(values) == BORN
    with pytest.raises(ValidationError, match=f"{next(iter(changed))}.* must be"):
        Roster.model_validate(values | changed)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"next_id": 16}, "16 tracks"),
        ({"born_k": np.array([0, 3], np.int32)}, "the last one of dwell 3, after 3 dwells"),
        ({"search_share": 1.1 * RADAR.array.power}, "search with power"),
    ],
)
def test_a_roster_of_tracks_that_cannot_have_begun_is_refused(changed: dict[str, Any], words: str) -> None:
    beams = scan(3, BORN).beams
    most = BORN.model_copy(update={"next_id": 15, "search_share": RADAR.array.power})
    check_roster(most, beams, RADAR, 3)
    with pytest.raises(Refused, match=words):
        check_roster(BORN.model_copy(update=changed), beams, RADAR, 3)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"existence": None, "confirmed": None}, "without existence"),
        ({"in_doubt": None}, "without existence"),
        ({"modes": None}, "without modes"),
        *(
            ({"modes": np.array(modes)}, "of motion: 3 probabilities")
            for modes in ([0.5, 0.5], [1.1, -0.1, 0.0], [0.3] * 3)
        ),
        ({"bins": np.array([16], np.int32)}, "16 bins exist"),
        ({"nus": None, "gate": None}, "without directions"),
        ({"target": 15}, "there can be 15"),
    ],
)
def test_a_plan_without_what_its_sky_asks_for_is_refused(changed: dict[str, Any], words: str) -> None:
    check_plan(plan(3, 0), RADAR)
    check_plan(plan(3, 0, status="ended"), RADAR)
    with pytest.raises(Refused, match=words):
        check_plan(plan(3, 0).model_copy(update=changed), RADAR)


def test_nobody_searches_for_an_unknown_number_and_none_of_a_known_one_ends() -> None:
    searching = Plan(run="r", k=3, t=0, target=0, status="searching")
    check_plan(searching, SMOKE.radar)
    with pytest.raises(Refused, match="is searching: tracks = unknown"):
        check_plan(searching, RADAR)
    with pytest.raises(Refused, match="is ended: tracks = 2"):
        check_plan(plan(3, 0, status="ended"), SMOKE.radar)
    with pytest.raises(Refused, match="with existence"):
        check_plan(searching.model_copy(update={"in_doubt": False}), SMOKE.radar)
    with pytest.raises(Refused, match="with modes"):
        check_plan(searching.model_copy(update={"modes": np.array([1.0, 0.0, 0.0])}), SMOKE.radar)
