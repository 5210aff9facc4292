"""Positions on the earth, against an implementation of others."""

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic

from cogradar.services.skies.place import Place, dwell_s
from cogradar.shared.scenario.scenario import SiteSection


@pytest.mark.parametrize("place", [Place(48.35, 11.79, 0.0), Place(-33.9, 179.9, 250.0), Place(0.0, -180.0, 90.0)])
def test_positions_are_those_of_geographiclib(place: Place) -> None:
    x, y = np.random.default_rng(3).uniform(-500.0, 500.0, (2, 50))
    x[0] = y[0] = 0.0
    found = place.positions(x, y)
    for i in range(x.size):
        azimuth = place.boresight + np.degrees(np.arctan2(y[i], x[i]))
        there = Geodesic.WGS84.Direct(place.latitude, place.longitude, azimuth, 1e3 * np.hypot(x[i], y[i]))
        off = Geodesic.WGS84.Inverse(found.latitudes[i], found.longitudes[i], there["lat2"], there["lon2"])
        assert off["s12"] < 1e-3
        turned = found.azimuths[i] + np.degrees(np.arctan2(y[i], x[i])) - there["azi2"]
        assert (turned + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6)
    assert np.abs(found.longitudes).max() <= 180.0


def test_what_is_seen_is_where_it_is() -> None:
    place = Place(48.35, 11.79, 300.0)
    assert place.seen(*place.position(120.0, -35.0)) == pytest.approx((120.0, -35.0), abs=1e-6)


def test_x_is_along_the_boresight_and_y_to_its_right() -> None:
    found = Place(48.0, 11.0, 90.0).positions([100.0, 0.0], [0.0, 100.0])
    assert found.longitudes[0] > 12.0
    assert found.latitudes[1] < 47.2
    assert np.isnan(Place(48.0, 11.0, 90.0).positions([np.nan], [1.0]).latitudes).all()


def test_a_dwell_has_a_time_if_the_run_has_a_begin() -> None:
    site = SiteSection(latitude_deg=48.0, longitude_deg=11.0, boresight_deg=0.0, begin_utc="1970-01-02T00:00:01Z")
    assert dwell_s(site, 10, 0.5) == 86406.0
    assert dwell_s(site.model_copy(update={"begin_utc": None}), 10, 0.5) is None
