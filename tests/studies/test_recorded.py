"""Sample trajectories of the package `traffic` become a recording that `cogradar sky --from` reads."""

import gzip
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import cogradar
from cogradar.services.skies.place import Place
from cogradar.services.skies.recorded import recorded as read
from studies import recorded

PLACE = Place(48.0, 2.0, 0.0)
Sample = Callable[[list[dict[str, object]]], Path]


@pytest.fixture
def sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Sample:
    """A folder of samples with one that has these rows."""

    def make(rows: list[dict[str, object]]) -> Path:
        (tmp_path / "mine.json.gz").write_bytes(gzip.compress(json.dumps(rows).encode()))
        monkeypatch.setattr(recorded, "collections", lambda: tmp_path)
        return tmp_path / "positions.csv"

    return make


def _flight(jitter_s: float, **more: object) -> list[dict[str, object]]:
    """Straight north at 0.2 km/s for 200 s, a position every second, heard up to a second late."""
    rng = np.random.default_rng(1)
    rows: list[dict[str, object]] = []
    for t in range(200):
        latitude, longitude = PLACE.position(20.0 + 0.2 * (t - jitter_s * float(rng.uniform())), 3.0)
        rows.append({"timestamp": 1e3 * (1000 + t), "icao24": "0abc", "latitude": latitude, "longitude": longitude})
        rows[-1] |= more
    return rows


def test_a_straight_flight_stays_straight_whatever_its_times(sample: Sample) -> None:
    file = sample(_flight(1.0, onground=False))
    assert recorded.write("mine", 1030.0, 1150.0, file) == 24
    (target,) = read(file, PLACE, 100.0).targets
    t, x, y = np.array(target["trajectory"]).T
    assert np.abs(np.diff(x) / np.diff(t) - 0.2).max() < 0.03
    assert np.abs(y - 3.0).max() < 0.01
    speeds = np.diff(x) / np.diff(t)
    assert np.abs(np.diff(speeds)).max() / 5.0 < 0.005  # km/s^2, half a g; up to some g without smoothing


def test_what_is_on_the_ground_has_no_position_or_repeats_it_is_left_out(sample: Sample) -> None:
    flown, parked = _flight(0.0), [row | {"icao24": "0def", "onground": True} for row in _flight(0.0)]
    silent = [row | {"icao24": "0aaa", "latitude": None, "longitude": None} for row in _flight(0.0)]
    stuck = [row | {"icao24": "0bbb", "latitude": 48.2, "longitude": 2.0} for row in _flight(0.0)]
    file = sample([*flown, *parked, *silent, *stuck])
    recorded.write("mine", 1030.0, 1150.0, file)
    assert {line.split(",")[1] for line in file.read_text().splitlines()[1:]} == {"0abc"}


def test_what_there_is_not_is_said(sample: Sample) -> None:
    file = sample(_flight(0.0))
    with pytest.raises(cogradar.BadInput, match="other: must be one of mine"):
        recorded.write("other", 1030.0, 1150.0, file)
    with pytest.raises(cogradar.BadInput, match="mine: has no aircraft between 5000 and 6000 s"):
        recorded.write("mine", 5000.0, 6000.0, file)
    assert not file.exists()


def test_the_package_is_read_and_not_imported() -> None:
    assert (recorded.collections() / "quickstart.json.gz").stat().st_size > 1_000_000
