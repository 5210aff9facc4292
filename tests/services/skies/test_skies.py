"""Scenarios of whole skies: traffic that is made up, and recordings of it flown again."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic

from cogradar.services.errors import BadInput
from cogradar.services.runs.in_process import play
from cogradar.services.skies.make import Asked, write
from cogradar.services.skies.place import Place
from cogradar.services.skies.recorded import recorded
from cogradar.services.skies.traffic import traffic
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.limits import MAX_TRACKS
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.world.targets import Flights

ORIGIN, BORESIGHT, RANGE_KM = "48.35,11.79", 60.0, 100.0
PLACE = Place(48.35, 11.79, BORESIGHT)


def asked(positions: Path | None = None, *, origin: str | None = ORIGIN, aircraft: int = 5) -> Asked:
    if positions is not None:
        return Asked(None, None, 5, positions, origin, BORESIGHT, RANGE_KM)
    return Asked(str(aircraft), 5, 5, None, origin, BORESIGHT, RANGE_KM)


def positions(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """States of all targets second by second, and whether they are there: (T, M, 4), (T, M)."""
    flights = Flights(scenario.simulated, 1.0, 5)
    states = [flights.start()]
    for t in range(1, scenario.dwells + 1):
        states.append(flights.moved(states[-1], t))
    return np.array(states), np.array([flights.present(state, t) for t, state in enumerate(states)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario of made-up traffic, a recording of it, and the scenario of that."""
    folder = tmp_path_factory.mktemp("sky")
    write(asked(), folder / "sky.toml", force=False)
    write(asked(), folder / "positions.csv", force=False)
    write(asked(folder / "positions.csv"), folder / "again.toml", force=False)
    return folder


@pytest.mark.slow
def test_a_radar_finds_and_keeps_most_of_a_thousand_aircraft(tmp_path: Path) -> None:
    """300 tracks were the most, and 999 aircraft."""
    write(Asked("1000", 1, 1, None, None, 0.0, RANGE_KM), tmp_path / "crowd.toml", force=False)
    scenario = load(str(tmp_path / "crowd.toml"), [f"radar.max_tracks={MAX_TRACKS}"])
    done = play(RunStart.of(scenario, Strategy.POWER_AWARE, 1, 12))
    assert done.run["status"] == "complete"
    assert sum(row["tracked"] for row in done.targets) > 750


def test_made_up_aircraft_come_and_go_within_the_edge(folder: Path) -> None:
    scenario = load(str(folder / "sky.toml"))
    states, there = positions(scenario)
    assert (scenario.n_target, scenario.radar.tracks) == (5, "unknown")
    assert there.any(axis=0).all()
    assert there[0].any()
    assert not there.all()
    ranges = np.hypot(states[..., 0], states[..., 2])
    assert ranges[there].max() < 1.1 * RANGE_KM  # the noise carries them a little further
    assert np.abs(states[..., [1, 3]]).max() < scenario.radar.acquisition.v_max_km_s
    assert traffic(1, 60, 40.0, 5) == traffic(1, 60, 40.0, 5) != traffic(1, 60, 40.0, 6)


@pytest.mark.parametrize("n", [5, 12])
def test_a_sky_of_one_aircraft_more_has_the_others_as_they_were(n: int) -> None:
    assert traffic(n + 1, 600, 40.0, 2)[:n] == traffic(n, 600, 40.0, 2)


def test_arrivals_are_those_of_a_poisson_process() -> None:
    """Given how many there are, aircraft are as likely to be there in the first minutes as in the last ones."""
    births = [target.get("born_s", 0.0) for target in traffic(24, 3600, 40.0, 1)]
    later = [born for born in births if born > 0.0]
    assert 0 < len(births) - len(later) < 12  # some have come before
    assert abs(np.mean(later) - 1800.0) < 4.0 * 3600.0 / np.sqrt(12.0 * len(later))


def test_a_recording_of_a_sky_is_flown_as_that_sky_was(folder: Path) -> None:
    """Its clock begins when all who are there have been heard; a position is told every five seconds, to 0.1 m."""
    (made, there), (again, heard) = (positions(load(str(folder / f"{name}.toml"))) for name in ("sky", "again"))
    rows = list(csv.DictReader(io.StringIO((folder / "positions.csv").read_text())))
    begin = min(int(row["time"]) for row in rows) + 20
    site = load(str(folder / "again.toml")).site
    assert site is not None
    assert Place.of(site) == PLACE
    assert load(str(folder / "sky.toml")).site is None  # made up, and nowhere
    n_close = 0
    for m in range(again.shape[1]):
        at = np.flatnonzero(heard[:, m])
        off = np.hypot(*np.moveaxis(made[at + begin][:, :, ::2] - again[at, m : m + 1, ::2], -1, 0))
        nearest = off.max(axis=0).argmin()
        assert off[:, nearest].max() < 0.02
        n_close += 1
    assert n_close >= 4
    assert heard.sum() > 0.9 * there[begin:].sum()


def test_positions_are_on_the_ellipsoid_with_x_along_the_boresight(tmp_path: Path) -> None:
    """Names, times and order as archives have them; rows that say nothing, or the last thing again, are left out."""
    rows = ["Timestamp,ICAO24,latitude,Longitude,altitude"]
    for t in range(0, 60, 10):
        ahead = Geodesic.WGS84.Direct(48.35, 11.79, BORESIGHT, 20e3 + 200.0 * t)
        right = Geodesic.WGS84.Direct(48.35, 11.79, BORESIGHT + 90.0 - 0.1 * t, 30e3)
        rows += [f"2026-01-01T00:00:{t:02d}Z,AAA,{ahead['lat2']},{ahead['lon2']},1e4"]
        rows += [f"2026-01-01T00:00:{t:02d}Z,bbb,{right['lat2']},{right['lon2']},"]
        rows += [f"2026-01-01T00:00:{t + 5:02d}Z,bbb,{right['lat2']},{right['lon2']},", f",ccc,,{t},NaN"]
    file = tmp_path / "p.csv"
    file.write_text("\n".join([rows[0], *reversed(rows[1:])]))
    found = recorded(file, PLACE, RANGE_KM)
    assert (found.aircraft, found.seconds) == (2, 30)
    ahead, right = (np.array(target["trajectory"]) for target in found.targets)
    times = np.arange(-20.0, 31.0, 10.0)
    np.testing.assert_allclose(ahead, np.column_stack((times, 24.0 + 0.2 * times, 0.0 * times)), atol=1e-3)
    np.testing.assert_allclose(right[:, 0], times)
    np.testing.assert_allclose(np.hypot(right[:, 1], right[:, 2]), 30.0, atol=1e-3)
    assert right[0, 2] == pytest.approx(30.0, abs=1e-3)  # to the right
    assert (np.diff(right[:, 1]) > 0.0).all()


def test_a_gap_ends_a_flight_and_who_is_behind_the_radar_is_left_out(tmp_path: Path) -> None:
    rows = ["time,hex,lat,lon"]
    for aircraft, azimuth in (("aaa", BORESIGHT), ("bbb", BORESIGHT + 180.0)):
        for t in [*range(0, 100, 10), *range(300, 400, 10)]:
            at = Geodesic.WGS84.Direct(48.35, 11.79, azimuth, 20e3 + 10.0 * t)
            rows.append(f"{1_700_000_000_000 + 1000 * t},{aircraft},{at['lat2']},{at['lon2']}")
    file = tmp_path / "p.csv"
    file.write_text("\n".join(rows))
    found = recorded(file, PLACE, RANGE_KM)
    assert [(one["trajectory"][0][0], one["trajectory"][-1][0]) for one in found.targets] == [(-20, 70), (280, 370)]


def test_who_starts_beside_another_is_there_as_well(tmp_path: Path) -> None:
    rows = ["time,hex,lat,lon"]
    for aircraft, azimuth in (("aaa", BORESIGHT), ("bbb", BORESIGHT + 0.3)):
        for t in range(0, 100, 10):
            at = Geodesic.WGS84.Direct(48.35, 11.79, azimuth, 20e3 + 10.0 * t)
            rows.append(f"{t},{aircraft},{at['lat2']},{at['lon2']}")
    (tmp_path / "p.csv").write_text("\n".join(rows))
    said = write(asked(tmp_path / "p.csv"), tmp_path / "p.toml", force=False)
    assert said.said == "2 aircraft in 70 dwells, 2 of them there at the start"
    assert [target.born_s for target in load(str(tmp_path / "p.toml")).simulated.targets] == [0.0, 0.0]


def test_glitches_and_positions_of_one_moment_do_not_bend_a_course(tmp_path: Path) -> None:
    """Two receivers tell one position 20 ms apart and 60 m from each other; another is 40 km beside the course."""
    rows = ["time,hex,lat,lon"]
    for t, beside_m in ((0, 0), (5, 0), (5.02, 60), (5.0201, 60), (40, 0), (45, 40e3), (50, 0), (60, 0)):
        at = Geodesic.WGS84.Direct(48.35, 11.79, BORESIGHT, 60e3 - 200.0 * t + beside_m)
        rows.append(f"{t},aaa,{at['lat2']},{at['lon2']}")
    (tmp_path / "p.csv").write_text("\n".join(rows))
    (flown,) = recorded(tmp_path / "p.csv", PLACE, RANGE_KM).targets
    begin = flown["trajectory"][0][0]
    assert [t - begin for t, _, _ in flown["trajectory"]] == [0, 5, 40, 50, 60]
    assert [x for _, x, _ in flown["trajectory"]] == pytest.approx([60.0, 59.0, 52.0, 50.0, 48.0], abs=0.01)


def test_a_row_without_the_best_time_has_the_next_one(tmp_path: Path) -> None:
    rows = ["time,icao24,lat,lon,lastposupdate"]
    for t in range(0, 100, 10):
        at = Geodesic.WGS84.Direct(48.35, 11.79, BORESIGHT, 20e3 + 200.0 * t)
        rows.append(f"{t + 3 if t % 20 else t},aaa,{at['lat2']},{at['lon2']},{t if t % 20 else 'NaN'}")
    (tmp_path / "p.csv").write_text("\n".join(rows))
    (flown,) = recorded(tmp_path / "p.csv", PLACE, RANGE_KM).targets
    assert [x for t, x, _ in flown["trajectory"]] == pytest.approx(np.arange(20.0, 39.0, 2.0), abs=0.01)
    assert np.diff([t for t, _, _ in flown["trajectory"]]).tolist() == [10.0] * 9


def test_no_more_rows_are_read_than_there_may_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What comes after them is not even looked at; positions elsewhere do not count."""
    monkeypatch.setattr("cogradar.services.skies.recorded.MOST_POSITIONS", 3)
    near = [f"{t},a,48.4,{11.9 + t / 1000}" for t in range(4)]
    rows = ["time,hex,lat,lon", *(f"{t},b,9,9" for t in range(9)), *near, "not a time,b,9,9"]
    (tmp_path / "p.csv").write_text("\n".join(rows))
    with pytest.raises(BadInput, match="more than 3 positions near the radar, must be fewer"):
        recorded(tmp_path / "p.csv", PLACE, RANGE_KM)


def test_a_scenario_that_is_refused_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "sky.toml"
    file.write_text("mine")
    monkeypatch.setattr("cogradar.services.skies.files.SIGMA_S", -1.0)
    with pytest.raises(BadInput, match=r"sky\.toml.*sigma_s_km_s2"):
        write(asked(), file, force=True)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("lat,lon,hex\n", "no column for the time, must have one of lastposupdate, time"),
        ("time,lat,lon\n", "no column for the aircraft, must have one of icao24, hex"),
        ("time,hex,lat,lon\nsoon,a,48,11\n", "row 2: time = 'soon': must be seconds or as ISO 8601 has it"),
        ("time,hex,lat,lon\n1,a,north,11\n", "row 2: latitude = 'north': must be a number"),
        ("time,hex,lat,lon\n1,a,99,11\n", "1 no such latitude and longitude (row 2: 99, 11)"),
        ("time,hex,lat,lon\n1,a,0,0\n", "no aircraft with two positions within 100 km before the radar at 48.35,11.79"),
        ("", "is empty: must have a header"),
    ],
)
def test_recordings_that_are_none(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(content)
    with pytest.raises(BadInput, match=r"p\.csv: [^\n]*$") as caught:
        write(asked(tmp_path / "p.csv"), tmp_path / "p.toml", force=False)
    assert words in str(caught.value)
    assert not (tmp_path / "p.toml").exists()


def test_options_that_make_no_sense(folder: Path) -> None:
    for options, file, words in (
        (asked(), "sky.toml", "is there already; --force replaces it"),
        (asked(), "sky.txt", "must end with .toml or .csv"),
        (asked(folder / "none.csv"), "new.toml", "none.csv: no such file"),
        (asked(folder / "positions.csv", origin=None), "new.toml", "--origin LAT,LON: must be given"),
        (asked(folder / "positions.csv", origin="91,0"), "new.toml", "--origin 91,0: must be LAT,LON in degrees"),
        (asked(folder / "positions.csv"), "new.csv", "must end with .toml"),
    ):
        with pytest.raises(BadInput) as caught:
            write(options, folder / file, force=False)
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("column", "texts", "heights"),
    [
        ("z_km", ["", "10.0", "", "9.0", "9.0"], [10.0, 10.0, 10.0, 9.0, 9.0]),
        ("baroaltitude", ["10000", "nan", "9000", "9000", "-50"], [10.0, 10.0, 9.0, 9.0, 0.0]),
        ("alt_baro", ["30000", "ground", "30000", "", "10000"], [9.144, 0.0, 9.144, 9.144, 3.048]),
        ("altitude,geoaltitude", ["30000,31000", ",", ",31000", "10000,", ","], [9.144, 9.144, 9.144, 3.048, 3.048]),
    ],
)
def test_altitudes_of_a_recording_are_read_in_the_unit_of_their_column(
    column: str, texts: list[str], heights: list[float], tmp_path: Path
) -> None:
    rows = [f"time,hex,lat,lon,{column}"]
    for i, text in enumerate(texts):
        at = Geodesic.WGS84.Direct(48.35, 11.79, BORESIGHT, 20e3 + 2000.0 * i)
        rows.append(f"{10 * i},aaa,{at['lat2']},{at['lon2']},{text}")
    (tmp_path / "p.csv").write_text("\n".join(rows))
    (flat,) = recorded(tmp_path / "p.csv", PLACE, RANGE_KM).targets
    assert {len(row) for row in flat["trajectory"]} == {3}
    write(asked(tmp_path / "p.csv")._replace(heights=True, ground=True), tmp_path / "sky.toml", force=False)
    (target,) = load(str(tmp_path / "sky.toml")).simulated.targets
    assert [row[3] for row in target.trajectory or []] == pytest.approx(heights)
    assert "--heights" in (tmp_path / "sky.toml").read_text().splitlines()[0]
    assert load(str(tmp_path / "sky.toml")).radar.assumes.height_max_km == 12.0


@pytest.mark.parametrize("column", ["flightlevel,300", "altitude_m,high", "altitude_m,2e5"])
def test_altitudes_that_are_none_are_refused(column: str, tmp_path: Path) -> None:
    header, text = column.split(",")
    (tmp_path / "p.csv").write_text(f"time,hex,lat,lon,{header}\n0,aaa,48.36,11.9,{text}\n9,aaa,48.37,11.9,{text}")
    with pytest.raises(BadInput, match="no row has an altitude, which --heights needs"):
        recorded(tmp_path / "p.csv", PLACE, RANGE_KM, heights=True)
    with pytest.raises(BadInput, match="--heights: needs --from"):
        write(asked()._replace(heights=True), tmp_path / "sky.toml", force=False)
