"""Where x and y of the radar are on the earth: distance and azimuth along the ellipsoid WGS 84, in one place."""

from math import atan2, cos, pi, radians, sin
from typing import NamedTuple, Self

import numpy as np
from geographiclib.geodesic import Geodesic
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.scenario.scenario import SiteSection

_A, _F = 6_378_137.0, 1.0 / 298.257223563  # equatorial radius in m, flattening
_B = _A * (1.0 - _F)
_ITERATIONS = 8  # of the series for the arc: each takes three digits, and an arc of 1000 km needs four of them


class Positions(NamedTuple):
    """Positions on the ellipsoid, degrees; each (n,)."""

    latitudes: NDArray[np.float64]
    longitudes: NDArray[np.float64]  # -180 .. 180
    azimuths: NDArray[np.float64]  # of a vector (1, 0) of the plane at that position, clockwise from north


class Place(NamedTuple):
    """Where the radar is and where it looks, degrees."""

    latitude: float
    longitude: float
    boresight: float  # of the x axis, from north, clockwise, as is y from x

    @classmethod
    def of(cls, site: SiteSection) -> Self:
        """The place of a site."""
        return cls(site.latitude_deg, site.longitude_deg, site.boresight_deg)

    def seen(self, latitude: float, longitude: float) -> tuple[float, float]:
        """x and y of a position, km."""
        found = Geodesic.WGS84.Inverse(self.latitude, self.longitude, latitude, longitude)
        angle, range_km = radians(found["azi1"] - self.boresight), found["s12"] / 1e3
        return range_km * cos(angle), range_km * sin(angle)

    def position(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude of x and y in km."""
        found = self.positions([x], [y])
        return float(found.latitudes[0]), float(found.longitudes[0])

    def positions(self, x: ArrayLike, y: ArrayLike) -> Positions:
        """The positions of x and y in km, (n,) each; NaN stays NaN.

        T. Vincenty, Direct and inverse solutions of geodesics on the ellipsoid, Survey Review 23 (1975), eq. 1-11; off
        by less than 1 mm. The package `geographiclib` takes 0.1 ms for each.
        """
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        angle, s = np.arctan2(y, x), 1e3 * np.hypot(x, y)
        azimuth, latitude = radians(self.boresight) + angle, radians(self.latitude)
        reduced = atan2((1.0 - _F) * sin(latitude), cos(latitude))
        sin_u, cos_u, cos_1 = sin(reduced), cos(reduced), np.cos(azimuth)
        sigma_1, sin_alpha = np.arctan2(sin_u, cos_u * cos_1), cos_u * np.sin(azimuth)
        cos2_alpha = 1.0 - sin_alpha**2
        u2 = cos2_alpha * (_A**2 - _B**2) / _B**2
        a = 1.0 + u2 / 16384.0 * (4096.0 + u2 * (-768.0 + u2 * (320.0 - 175.0 * u2)))
        b = u2 / 1024.0 * (256.0 + u2 * (-128.0 + u2 * (74.0 - 47.0 * u2)))
        first = sigma = s / (_B * a)
        for _ in range(_ITERATIONS):
            mid = np.cos(2.0 * sigma_1 + sigma)
            inner = np.cos(sigma) * (2.0 * mid**2 - 1.0)
            inner -= b / 6.0 * mid * (4.0 * np.sin(sigma) ** 2 - 3.0) * (4.0 * mid**2 - 3.0)
            sigma = first + b * np.sin(sigma) * (mid + b / 4.0 * inner)
        sin_s, cos_s, mid = np.sin(sigma), np.cos(sigma), np.cos(2.0 * sigma_1 + sigma)
        along = sin_u * sin_s - cos_u * cos_s * cos_1
        latitudes = np.arctan2(sin_u * cos_s + cos_u * sin_s * cos_1, (1.0 - _F) * np.hypot(sin_alpha, along))
        sphere = np.arctan2(sin_s * np.sin(azimuth), cos_u * cos_s - sin_u * sin_s * cos_1)
        c = _F / 16.0 * cos2_alpha * (4.0 + _F * (4.0 - 3.0 * cos2_alpha))
        arc = sigma + c * sin_s * (mid + c * cos_s * (2.0 * mid**2 - 1.0))
        longitudes = radians(self.longitude) + sphere - (1.0 - c) * _F * sin_alpha * arc
        turned = np.arctan2(sin_alpha, -along) - angle
        return Positions(
            np.degrees(latitudes), np.degrees((longitudes + pi) % (2.0 * pi) - pi), np.degrees(turned) % 360.0
        )


def dwell_s(site: SiteSection, t: int, dt_s: float) -> float | None:
    """When dwell t was, s since 1970 in UTC, of a run whose site says when it began; None: it does not say."""
    begin_s = site.begin_s
    return None if begin_s is None else begin_s + t * dt_s
