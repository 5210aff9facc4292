"""Pictures as no radar made them: tracks anywhere, moving anyhow."""

from typing import Any

import numpy as np

from cogradar.services.feed.picture import Picture, Track
from cogradar.services.skies.place import Place
from cogradar.shared.scenario.scenario import SiteSection

SITE = SiteSection(latitude_deg=48.35, longitude_deg=11.79, height_m=453.0, boresight_deg=60.0)
UTC_S = 1_790_000_000.0


def track(number: int, x: float = 50.0, y: float = 10.0, **fields: Any) -> Track:
    at = Place.of(SITE).positions([x], [y])
    azimuth = np.radians(SITE.boresight_deg) + np.arctan2(y, x)
    made = Track(
        number=number,
        latitude=float(at.latitudes[0]),
        longitude=float(at.longitudes[0]),
        east_km=float(np.hypot(x, y) * np.sin(azimuth)),
        north_km=float(np.hypot(x, y) * np.cos(azimuth)),
        velocity=(100.0, -200.0),
        covariance=np.diag([100.0**2, 5.0**2, 50.0**2, 3.0**2]),
        confirmed=True,
        existence=0.99,
        seen_s=0.0,
    )
    return made._replace(**fields)


def picture(*tracks: Track, t: int = 1, run: str = "r-1") -> Picture:
    return Picture(run, t, UTC_S + t, 1.0, SITE, is_simulated=True, tracks=tracks)


def crowd(n: int, seed: int, t: int = 1) -> Picture:
    """A picture of n tracks, each with values of its own."""
    draw = np.random.default_rng(seed)
    xs, ys = draw.uniform(-250.0, 250.0, (2, n))
    factors = draw.normal(size=(n, 4, 4)) * np.array([200.0, 10.0, 200.0, 10.0])[:, np.newaxis]
    return picture(
        *(
            track(
                i + 1,
                float(xs[i]),
                float(ys[i]),
                velocity=tuple(draw.uniform(-700.0, 700.0, 2).tolist()),
                covariance=factors[i] @ factors[i].T,
                confirmed=bool(draw.random() < 0.8),
                seen_s=float(draw.integers(0, 20)),
            )
            for i in range(n)
        ),
        t=t,
    )
