"""ASTERIX as other programs read it: the decoder is the library `libasterix`, no line of which is ours."""

import math
from collections.abc import Iterator
from typing import Any

import asterix.base as decoder
import asterix.generated as categories
import numpy as np
import pytest

from cogradar.services.feed.asterix import MAX_BYTES, NUMBERS, PAUSE_S, Asterix, Numbers, Source, categories_of
from cogradar.services.feed.output import Output
from cogradar.services.feed.picture import Picture, Plot
from tests.services.feed.made import SITE, UTC_S, crowd, picture, track

UAPS = {34: categories.Cat_034_1_29.cv_uap, 48: categories.Cat_048_1_32.cv_uap, 62: categories.Cat_062_1_20.cv_uap}
SOURCE = Source(25, 7)
TRACKS = 3000


def records(outputs: list[Output]) -> Iterator[tuple[int, Any]]:
    """Category and record of all that was sent."""
    for output in outputs:
        assert len(output.data) <= MAX_BYTES
        blocks = decoder.RawDatablock.parse(decoder.Bits.from_bytes(output.data))
        assert not isinstance(blocks, ValueError)
        for block in blocks:
            found = UAPS[block.get_category()].parse(block.get_raw_records())
            assert not isinstance(found, ValueError), found
            yield from ((block.get_category(), record) for record in found)


def element(record: Any, item: str, *inner: str) -> Any:
    """The content of an item, or of a part of it."""
    found = record.get_item(item)
    for name in inner:
        found = found.variation.get_item(name)
    return found.variation


def quantity(record: Any, unit: str, item: str, *inner: str) -> float:
    return float(element(record, item, *inner).content.as_quantity(unit))


def whole(record: Any, item: str, *inner: str) -> int:
    return int(element(record, item, *inner).as_uint())


def check_tracks(made: Picture, form: Asterix) -> None:
    """Every field of every track, to half a unit of the format."""
    sent = [record for category, record in records(form.encode(made)) if category == 62]
    sent = [record for record in sent if not whole(record, "080", "TSE")]
    assert len(sent) == len(made.tracks)
    assert len({whole(record, "040") for record in sent}) == len(sent)
    day_s = made.utc_s % 86_400.0
    for record, of in zip(sent, made.tracks, strict=True):
        assert (whole(record, "010", "SAC"), whole(record, "010", "SIC")) == SOURCE
        assert quantity(record, "s", "070") == pytest.approx(day_s, abs=1.0 / 256.0)
        half = 90.0 / 2.0**25 * 1.001
        assert quantity(record, "°", "105", "LAT") == pytest.approx(of.latitude, abs=half)
        assert quantity(record, "°", "105", "LON") == pytest.approx(of.longitude, abs=half)
        assert quantity(record, "m", "100", "X") == pytest.approx(1e3 * of.east_km, abs=0.2501)
        assert quantity(record, "m", "100", "Y") == pytest.approx(1e3 * of.north_km, abs=0.2501)
        assert quantity(record, "m/s", "185", "VX") == pytest.approx(of.velocity[0], abs=0.1251)
        assert quantity(record, "m/s", "185", "VY") == pytest.approx(of.velocity[1], abs=0.1251)
        status = {name: whole(record, "080", name) for name in ("MON", "CNF", "SIM", "TSE", "CST", "SPI", "PSR")}
        assert status == {
            "MON": 1,
            "CNF": int(not of.confirmed),
            "SIM": int(made.is_simulated),
            "TSE": 0,
            "CST": int(of.seen_s > 0.0),
            "SPI": 0,
            "PSR": 0,
        }
        assert quantity(record, "s", "290", "PSR") == of.seen_s
        sigmas = np.sqrt(np.diag(of.covariance))
        assert quantity(record, "m", "500", "APC", "X") == pytest.approx(sigmas[0], abs=0.2501)
        assert quantity(record, "m", "500", "APC", "Y") == pytest.approx(sigmas[2], abs=0.2501)
        product = of.covariance[0, 2]
        expected = math.copysign(math.sqrt(abs(product)), product)
        assert quantity(record, "m", "500", "COV") == pytest.approx(expected, abs=0.2501)
        assert quantity(record, "m/s", "500", "ATV", "X") == pytest.approx(min(sigmas[1], 63.75), abs=0.1251)
        assert quantity(record, "m/s", "500", "ATV", "Y") == pytest.approx(min(sigmas[3], 63.75), abs=0.1251)


def test_a_decoder_of_others_reads_every_field() -> None:
    check_tracks(crowd(TRACKS, seed=5), Asterix(SOURCE))


@pytest.mark.nightly
def test_a_decoder_of_others_reads_every_field_of_many_tracks() -> None:
    for seed in range(25):
        check_tracks(crowd(4000, seed=seed), Asterix(SOURCE))


def test_the_radar_is_told_before_its_tracks() -> None:
    (category, radar), *others = records(Asterix(SOURCE).encode(picture(track(1))))
    assert category == 34
    assert [category for category, _ in others] == [62]
    assert whole(radar, "000") == 1
    assert quantity(radar, "s", "030") == pytest.approx((UTC_S + 1.0) % 86_400.0)
    assert quantity(radar, "s", "041") == 1.0
    assert quantity(radar, "m", "120", "HGT") == SITE.height_m
    assert quantity(radar, "°", "120", "LAT") == pytest.approx(SITE.latitude_deg, abs=1.1e-5)
    assert quantity(radar, "°", "120", "LON") == pytest.approx(SITE.longitude_deg, abs=1.1e-5)


NM_KM = 1.852


def test_a_decoder_of_others_reads_plots_and_tracks_of_the_radar() -> None:
    draw = np.random.default_rng(3)
    plots = [Plot(*one) for one in draw.uniform((0.0, 0.0), (474.0, 360.0), (TRACKS, 2)).tolist()] + [
        Plot(0.0, 359.999)
    ]
    made = crowd(TRACKS, seed=6)._replace(plots=tuple(plots))
    sent = [
        record for category, record in records(Asterix(SOURCE, categories_of("048")).encode(made)) if category == 48
    ]
    assert len(sent) == len(plots) + len(made.tracks)
    for record in sent:
        assert (whole(record, "010", "SAC"), whole(record, "010", "SIC")) == SOURCE
        assert quantity(record, "s", "140") == pytest.approx(made.utc_s % 86_400.0, abs=1.0 / 256.0)
        assert whole(record, "020", "SIM") == 1
    for record, plot in zip(sent, plots, strict=False):
        assert whole(record, "020", "TYP") == 1  # a detection of a primary radar
        assert record.get_item("161") is None
        _check_polar(record, plot.range_km, plot.azimuth_deg)
    for record, of in zip(sent[len(plots) :], made.tracks, strict=True):
        assert whole(record, "020", "TYP") == 0  # the estimate is no detection
        azimuth = math.degrees(math.atan2(of.east_km, of.north_km))
        _check_polar(record, math.hypot(of.east_km, of.north_km), azimuth)
        half = 0.5001 / 128.0
        assert quantity(record, "NM", "042", "X") == pytest.approx(of.east_km / NM_KM, abs=half)
        assert quantity(record, "NM", "042", "Y") == pytest.approx(of.north_km / NM_KM, abs=half)
        assert quantity(record, "NM/s", "200", "GSP") == pytest.approx(of.speed / 1852.0, abs=0.5001 / 2**14)
        assert _turned(quantity(record, "°", "200", "HDG"), of.course_deg) <= 180.01 / 65536.0
        names = ("CNF", "RAD", "DOU", "MAH", "CDM")
        assert [whole(record, "170", name) for name in names] == [int(not of.confirmed), 1, 0, 0, 3]


def _check_polar(record: Any, range_km: float, azimuth_deg: float) -> None:
    assert quantity(record, "NM", "040", "RHO") == pytest.approx(range_km / NM_KM, abs=0.5001 / 256.0)
    assert _turned(quantity(record, "°", "040", "THETA"), azimuth_deg) <= 180.01 / 65536.0


def _turned(a: float, b: float) -> float:
    return abs((a - b + 180.0) % 360.0 - 180.0)


def test_beyond_what_category_048_can_say_there_is_no_report() -> None:
    form = Asterix(SOURCE, categories_of("048,062"))
    made = picture(track(1, 480.0, 0.0), track(2))._replace(plots=(Plot(474.2, 10.0), Plot(474.0, 10.0)))
    found = list(records(form.encode(made)))
    assert [category for category, _ in found] == [62, 62, 48, 48]
    assert [whole(record, "161") for _, record in found if record.get_item("161") is not None] == [1]
    (end,) = (r for category, r in records(form.encode(picture(track(1), t=2))) if category == 48 and _ends(r))
    assert (whole(end, "161"), whole(end, "170", "TRE")) == (1, 1)


def _ends(record: Any) -> bool:
    return record.get_item("040") is None


def test_a_track_has_a_first_and_a_last_record() -> None:
    form, flags = Asterix(SOURCE), list[list[tuple[int, int, int]]]()
    for made in (picture(track(3)), picture(track(3), track(9), t=2), picture(track(9), t=3), picture(t=4)):
        sent = [record for category, record in records(form.encode(made)) if category == 62]
        flags.append([(whole(r, "040"), whole(r, "080", "TSB"), whole(r, "080", "TSE")) for r in sent])
    assert flags == [[(0, 1, 0)], [(0, 0, 0), (1, 1, 0)], [(0, 0, 1), (1, 0, 0)], [(1, 0, 1)]]


def test_a_run_after_another_has_tracks_of_its_own() -> None:
    form = Asterix(SOURCE)
    form.encode(picture(track(3)))
    sent = [record for category, record in records(form.encode(picture(track(3), run="r-2"))) if category == 62]
    assert [(whole(r, "040"), whole(r, "080", "TSE")) for r in sent] == [(0, 1), (1, 0)]


def test_the_number_of_a_track_rests_before_another_has_it() -> None:
    numbers, given = Numbers(), list[tuple[float, int]]()
    for i in range(4 * NUMBERS):  # fifty tracks a second, of two seconds each
        found = numbers.give(i, 0.02 * i)
        assert found is not None
        assert found[1]
        assert numbers.give(i, 0.02 * i) == (found[0], False)
        given.append((0.02 * i, found[0]))
        if i >= 100:
            numbers.end(i - 100, 0.02 * i)
    last = dict[int, float]()
    for at, number in given:
        assert 0 <= number < NUMBERS
        assert at - last.get(number, -math.inf) >= 2.0 + PAUSE_S  # it lived, then rested
        last[number] = at


def test_without_a_number_that_has_rested_a_track_waits() -> None:
    numbers = Numbers()
    for i in range(NUMBERS):
        numbers.give(i, 0.0)
    assert numbers.give(NUMBERS, 1.0) is None
    numbers.end(17, 2.0)
    assert numbers.give(NUMBERS, 2.0 + PAUSE_S - 0.1) is None
    assert numbers.give(NUMBERS, 2.0 + PAUSE_S) == (17, True)


def test_what_does_not_fit_is_the_nearest_that_does() -> None:
    fast = track(1, velocity=(9000.0, -9000.0), seen_s=1000.0, covariance=np.diag([1e12, 1e6, 1e12, 1e6]))
    (record,) = (record for category, record in records(Asterix(SOURCE).encode(picture(fast))) if category == 62)
    assert quantity(record, "m/s", "185", "VX") == 8191.75
    assert quantity(record, "m/s", "185", "VY") == -8192.0
    assert quantity(record, "s", "290", "PSR") == 63.75
    assert quantity(record, "m", "500", "APC", "X") == 32767.5
