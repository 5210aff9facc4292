"""Airports, coast and borders around a site: where they are, how many at most, and nothing without the packages."""

import zipfile
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.web.app import create
from cogradar.services.web.maps import surroundings as maps
from cogradar.services.web.maps.surroundings import MOST_POINTS, Line, surroundings
from tests.services.web.conftest import FAST_S, ask

NICE, REACH_KM = (43.66, 7.2), 200.0


@pytest.fixture(autouse=True)
def _anew() -> None:
    surroundings.cache_clear()


def _distance_km(at: tuple[float, float], to: tuple[float, float]) -> float:
    return 1e-3 * float(Geodesic.WGS84.Inverse(*at, *to)["s12"])


def _nearest_km(at: tuple[float, float], lines: list[Line]) -> float:
    return min(_distance_km(at, point) for line in lines for point in line)


def test_airports_and_the_coast_are_where_they_are() -> None:
    found = surroundings(*NICE, REACH_KM)
    assert found is not None
    assert found.airports[0].code == "NCE"
    assert {"CEQ", "TLN", "GOA"} <= {one.code for one in found.airports}
    near = [_distance_km(NICE, (one.latitude_deg, one.longitude_deg)) for one in found.airports]
    assert np.all(np.diff(near) > -1.0)
    assert max(near) < 1.5 * REACH_KM
    for on_the_coast in ((43.5453, 7.1370), (43.6898, 7.3080), (42.7010, 9.4520)):  # Cap d'Antibes, Cap Ferrat, Bastia
        assert _nearest_km(on_the_coast, found.lines) < 3.0
    assert _nearest_km((43.0, 7.9), found.lines) > 50.0  # the open sea


def test_lines_do_not_end_at_the_date_line_and_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    found = surroundings(-17.7, 178.5, 400.0)
    assert found is not None
    assert {longitude > 0.0 for line in found.lines for _, longitude in line} == {True, False}
    surroundings.cache_clear()
    monkeypatch.setattr(maps, "MOST_POINTS", 300)
    fewer = surroundings(-17.7, 178.5, 400.0)
    assert fewer is not None
    assert 0 < sum(map(len, fewer.lines)) <= 300 < sum(map(len, found.lines)) <= MOST_POINTS


def test_more_lines_than_points_may_be_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each line two points are always kept, so that no thinning ends with fewer."""
    monkeypatch.setattr(maps, "MOST_POINTS", 20)
    found = surroundings(50.0, 10.0, 20_000.0)
    assert found is not None
    assert 0 < sum(map(len, found.lines)) <= 20


def test_without_the_packages_there_is_no_map_and_no_word(
    core: MetricsCore, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def missing(name: str) -> Any:
        raise PackageNotFoundError(name)

    app = create(core, None, FAST_S)
    assert ask(app, "/api/v1/runs/sited/radar").json()["surroundings"]["lines"]
    assert ask(app, "/api/v1/runs/whole/radar").json()["surroundings"] is None  # it has no site
    surroundings.cache_clear()
    monkeypatch.setattr(maps, "distribution", missing)
    app = create(core, None, FAST_S)  # one app gives an answer again for half a second
    assert ask(app, "/api/v1/runs/sited/radar").json()["surroundings"] is None
    assert [record for record in caplog.records if record.name.startswith("cogradar")] == []


def test_a_package_of_another_form_is_no_map_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class _Elsewhere:
        def locate_file(self, name: str) -> Path:
            return tmp_path / name

    monkeypatch.setattr(maps, "distribution", lambda _: _Elsewhere())
    assert surroundings(*NICE, REACH_KM) is None
    assert "airportsdata has no file airportsdata/airports.csv" in caplog.text
    (tmp_path / "airportsdata").mkdir()
    (tmp_path / maps.AIRPORTS[1]).write_text("icao,name\nLFMN,Nice\n")
    archive = tmp_path / maps.COUNTRIES[1]
    archive.parent.mkdir()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("a.shp", b"\x00" * 105)
    surroundings.cache_clear()
    assert surroundings(*NICE, REACH_KM) == ([], [])
    assert "no map: KeyError" in caplog.text
