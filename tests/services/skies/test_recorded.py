"""Files of the field: aircraft are not lost without a word, and every row is kept or counted."""

import bz2
import gzip
import lzma
import os
import re
import sys
import zipfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cogradar.services.errors import BadInput
from cogradar.services.skies.place import Place
from cogradar.services.skies.readers.report import Why
from cogradar.services.skies.recorded import Recording, recorded
from cogradar.services.skies.selection import Selection

PLACE, RANGE_KM = Place(48.35, 11.79, 60.0), 100.0
BEGIN_S = 1_714_564_800
HEADER = "time,icao24,lat,lon,callsign"


class Row(NamedTuple):
    t: float
    aircraft: str
    lat: float
    lon: float
    name: str


def straight(
    aircraft: str = "abc001",
    callsign: str = "TST101",
    *,
    speed: float = 0.2,
    y: float = 5.0,
    n: int = 60,
    every: int = 5,
) -> list[Row]:
    """A flight along the boresight, as seen each `every` seconds: km/s, km."""
    places = [PLACE.position(20.0 + speed * every * i, y) for i in range(n)]
    return [Row(BEGIN_S + every * i, aircraft, *at, callsign) for i, at in enumerate(places)]


def text(rows: Sequence[Row], header: str = HEADER, delimiter: str = ",") -> str:
    lines = [f"{t},{aircraft},{lat:.5f},{lon:.5f},{name}" for t, aircraft, lat, lon, name in rows]
    return "\n".join([header, *lines]).replace(",", delimiter) + "\n"


def read(tmp_path: Path, content: str | bytes, selection: Selection | None = None, name: str = "p.csv") -> Recording:
    """The recording, of which every row is kept or counted."""
    file = tmp_path / name
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    found = recorded(file, PLACE, RANGE_KM, selection=selection)
    rows = sum(len(target["trajectory"]) for target in found.targets)
    assert found.tally.kept == rows
    return found


def dropped(found: Recording) -> dict[Why, int]:
    return {why: one.rows for why, one in found.tally.dropped.items()}


def speeds(found: Recording) -> np.ndarray:
    """Of all flights, between rows, km/s."""
    rows = [np.array(target["trajectory"])[:, :3] for target in found.targets]
    return np.concatenate([np.hypot(*np.diff(row, axis=0).T[1:]) / np.diff(row[:, 0]) for row in rows])


def test_two_rows_of_1970_cost_no_memory_and_are_named(tmp_path: Path) -> None:
    rows = [
        Row(3.0, "abc001", 48.4, 12.0, ""),
        Row(8.0, "abc001", 48.4, 12.01, ""),
        *straight(),
        *straight("abc002", y=-9.0),
    ]
    found = read(tmp_path, text(rows))
    assert (found.aircraft, found.seconds, found.begin_utc) == (2, 275, "2024-05-01T12:00:20Z")
    assert dropped(found) == {Why.ELSEWHEN: 2}
    assert str(found.tally.dropped[Why.ELSEWHEN]) == "2 .. 3: 2 from 1970-01-01T00:00:03Z"
    early = read(tmp_path, text(rows), Selection.of("1970-01-01T00:00:00Z", None, None, ground=False))
    assert (early.aircraft, early.seconds, dropped(early)) == (1, 2, {Why.ELSEWHEN: 120})


@pytest.mark.parametrize("at", [0, 1, 20, 58, 59])
@pytest.mark.parametrize(("km", "silence_s"), [(40.0, 60), (5.0, 0), (-4.0, 0)])
def test_a_jump_is_dropped_wherever_it_is(at: int, km: float, silence_s: int, tmp_path: Path) -> None:
    # Where a straight flight is after the silence, but for the jump across the course.
    rows = list[Row]()
    for i, row in enumerate(straight()):
        t = row.t + (silence_s if i >= at else 0)
        where = PLACE.position(10.0 + 0.2 * (t - BEGIN_S), 5.0 + (km if i == at else 0.0))
        rows.append(Row(t, row.aircraft, *where, row.name))
    found = read(tmp_path, text(rows))
    assert dropped(found) == {Why.OUTLIER: 1}
    assert found.tally.dropped[Why.OUTLIER].first == at + 2
    np.testing.assert_allclose(speeds(found), 0.2, atol=0.01)


def test_turns_stay_whole(tmp_path: Path) -> None:
    """Ten degrees a second at 0.25 km/s, 4.4 g, and half a circle of three degrees a second; nothing is an outlier."""
    for rate, n in ((10.0, 18), (3.0, 60)):
        angle = np.radians(rate) * np.arange(n)
        radius = 0.25 / np.radians(rate)
        places = [PLACE.position(40.0 + radius * np.sin(a), radius * (1.0 - np.cos(a))) for a in angle.tolist()]
        rows = [Row(BEGIN_S + i, "abc001", *at, "") for i, at in enumerate(places)]
        assert dropped(read(tmp_path, text(rows))) == {}
        assert dropped(read(tmp_path, text(rows[::3]))) == {}


@pytest.mark.parametrize("legs", [(0, 60, 0), (30, 60, 30), (30, 60, 0), (0, 60, 30)])
def test_rest_is_no_silence(legs: tuple[int, int, int], tmp_path: Path) -> None:
    """A helicopter that flies, stands for five minutes and flies on is one flight; so is one that only stands."""
    steps = np.repeat([0.011, 0.0, 0.011], legs)
    places = [PLACE.position(30.0 + 5.0 * x, 3.0) for x in np.cumsum(steps).tolist()]
    rows = [Row(BEGIN_S + 5 * i, "heli02", *at, "") for i, at in enumerate(places)]
    found = read(tmp_path, text(rows))
    assert (len(found.targets), dropped(found)) == (1, {})
    assert found.targets[0]["trajectory"][-1][0] - found.targets[0]["trajectory"][0][0] == 5 * (sum(legs) - 1)


def test_the_last_position_told_again_is_silence(tmp_path: Path) -> None:
    """An archive repeats for a minute where an aircraft was that flew 0.2 km/s; or to the end of the file."""
    rows = straight()
    again = [rows[29]._replace(t=row.t) if 30 <= i < 42 else row for i, row in enumerate(rows)]
    for content in (again, again[:42]):
        found = read(tmp_path, text(content))
        assert dropped(found) == {Why.REPEATED: 12}
        assert speeds(found).max() < 0.21


def test_an_aircraft_without_an_address_stays_by_its_callsign(tmp_path: Path) -> None:
    """Of two aircraft one never has an address, the other in every second row."""
    two = [row if i % 2 else row._replace(aircraft="") for i, row in enumerate(straight("abc002", "TST202", y=-5.0))]
    rows = [*straight(), *two, *straight("<NA>", "TST303", y=20.0)]
    found = read(tmp_path, text(rows))
    assert (found.aircraft, dropped(found)) == (3, {})
    assert any("90 rows have no address" in note for note in found.tally.notes)


@pytest.mark.parametrize("token", ["", "nan", "NaN", "<NA>", "N/A", "-", "null", "None", "NaT", "  "])
def test_what_is_missing_may_be_said_in_many_ways(token: str, tmp_path: Path) -> None:
    rows = text(straight()).splitlines()
    rows[5] = f"{BEGIN_S},abc001,{token},{token},"
    rows[6] = f"{token},abc001,48.4,12.0,"
    rows[7] = f"{BEGIN_S},{token},48.4,12.0,{token}"
    found = read(tmp_path, "\n".join(rows))
    assert dropped(found) == {Why.NO_POSITION: 1, Why.NO_TIME: 1, Why.NO_AIRCRAFT: 1}


def zipped(content: bytes, tmp_path: Path) -> bytes:
    with zipfile.ZipFile(tmp_path / "z", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("p.csv", content)
    return (tmp_path / "z").read_bytes()


COMPRESSED: dict[str, Callable[[bytes, Path], bytes]] = {
    "gzip": lambda content, _: gzip.compress(content),
    "bzip2": lambda content, _: bz2.compress(content),
    "xz": lambda content, _: lzma.compress(content),
    "Zstandard": lambda content, _: zstandard.ZstdCompressor(write_checksum=True).compress(content),
    "ZIP": zipped,
}


def test_delimiters_compressions_and_encodings_are_found_out(tmp_path: Path) -> None:
    rows = straight()
    plain = read(tmp_path, text(rows))
    german = text(rows, delimiter=";").replace(".", ",")
    utf8 = text(rows).encode()
    contents: list[str | bytes] = [
        *(text(rows, delimiter=delimiter) for delimiter in (";", "\t", "|")),
        *(text(rows).encode(name) for name in ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252")),
        *(compress(utf8, tmp_path) for compress in COMPRESSED.values()),
        gzip.compress(text(rows, delimiter="\t").encode("utf-16"), mtime=0),
        text(rows).replace("\n", "\r\n"),
        "sep=;\r\n" + german,
        "# made by a receiver\n" + text(rows),
        text(rows, header='"Time","ICAO24","Latitude [deg]","Longitude (deg)","Call sign"'),
        text(rows[:30]) + text(rows[30:]).replace("time,icao24,lat,lon,callsign\n", ""),
        text(rows).partition("\n")[2],  # without a header
    ]
    for content in contents:
        assert read(tmp_path, content).targets == plain.targets, content[:60]
    assert dropped(read(tmp_path, text(rows[:30]) + text(rows[30:]))) == {Why.HEADER: 1}


@pytest.mark.parametrize(
    ("form", "tool"),
    [("gzip", "zcat"), ("bzip2", "bzcat"), ("xz", "xzcat"), ("Zstandard", "zstdcat"), ("ZIP", None)],
)
def test_a_compressed_file_that_is_cut_short_or_damaged_is_an_error(
    form: str, tool: str | None, tmp_path: Path
) -> None:
    """Of a large one, which is not decompressed at once."""
    whole = COMPRESSED[form](text(straight(n=5000, speed=0.0)).encode(), tmp_path)
    middle = len(whole) // 2
    cure = "fetch it again" + (f", or use what there is of it: {tool} < p.csv > part" if tool else "")
    words = f"is cut short: its {form} data end early; {cure}" if tool else "cannot be unpacked: File is not a zip file"
    with pytest.raises(BadInput, match=re.escape(f"p.csv: {words}")):
        read(tmp_path, whole[:middle])
    other = whole[:middle] + bytes(64) + whole[middle + 64 :]
    with pytest.raises(BadInput, match=rf"p\.csv: is damaged: its {form} data say .+; {re.escape(cure)}"):
        read(tmp_path, other)


def test_a_table_in_a_damaged_file_of_a_folder_is_named(tmp_path: Path) -> None:
    for name in ("a.gz", "b.gz"):
        (tmp_path / name).write_bytes(gzip.compress(text(straight()).encode())[: None if name == "a.gz" else -50])
    with pytest.raises(BadInput, match=r"b\.gz: is cut short"):
        recorded(tmp_path, PLACE, RANGE_KM)


def test_zstandard_without_its_library_names_the_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "compression" if sys.version_info >= (3, 14) else "backports", None)
    with pytest.raises(BadInput, match=r"pip install 'cogradar\[zstd\]', or decompress it first: zstd -d p.csv"):
        read(tmp_path, COMPRESSED["Zstandard"](text(straight()).encode(), tmp_path))


@pytest.mark.parametrize(
    "write",
    [
        lambda t: f"{1000 * t}",
        lambda t: f"{t}000000",
        lambda t: f"{t}000000000",
        lambda t: datetime.fromtimestamp(t, UTC).isoformat(),
        lambda t: datetime.fromtimestamp(t + 7200, UTC).strftime("%Y-%m-%d %H:%M:%S+02:00"),
        lambda t: datetime.fromtimestamp(t, UTC).strftime("%Y/%m/%d %H:%M:%S UTC"),
        lambda t: datetime.fromtimestamp(t, UTC).strftime("%Y-%m-%dT%H:%M:%S.000Z"),
    ],
)
def test_times_are_read_as_they_are_written(write: Callable[[int], str], tmp_path: Path) -> None:
    rows = text(straight()).splitlines()
    said = [rows[0], *(f"{write(BEGIN_S + 5 * i)},{row.partition(',')[2]}" for i, row in enumerate(rows[1:]))]
    assert read(tmp_path, "\n".join(said))[:4] == read(tmp_path, "\n".join(rows))[:4]


def test_rows_in_any_order_and_twice_are_the_same_recording(tmp_path: Path) -> None:
    rows = [*straight(), *straight("abc002", "", y=-9.0)]
    plain, shuffled = read(tmp_path, text(rows)), [rows[i] for i in np.random.default_rng(1).permutation(120)]
    found = read(tmp_path, text([*shuffled, *rows[:7]]))
    assert (found.targets, dropped(found)) == (plain.targets, {Why.DUPLICATE: 7})


@pytest.mark.parametrize("apart_s", [2, 3, 7])
def test_clocks_of_merged_feeds_are_noticed(apart_s: int, tmp_path: Path) -> None:
    """Half of the positions, other ones or the same, came with a clock that is some seconds late."""
    one = straight(every=2, n=150)
    late = [row._replace(t=row.t + apart_s) for row in one[1::2]]
    found = read(tmp_path, text([*one[::2], *late]))
    assert any("clocks differ" in note for note in found.tally.notes)
    np.testing.assert_allclose(speeds(found), 0.2, atol=0.01)
    twice = read(tmp_path, text([*one, *[row._replace(t=row.t + apart_s + 0.5) for row in one]]))
    assert dropped(twice) == {Why.REPEATED: 150}
    np.testing.assert_allclose(speeds(twice), 0.2, atol=0.01)


def test_two_aircraft_with_one_identifier_are_two(tmp_path: Path) -> None:
    found = read(tmp_path, text([*straight(), *straight(y=-50.0)]))
    assert (len(found.targets), dropped(found)) == (2, {})
    assert any("share an identifier" in note for note in found.tally.notes)
    days = [row._replace(t=row.t + 86_400) for row in straight()]
    later = read(tmp_path, text([*straight(n=40), *days]))
    assert (len(later.targets), dropped(later)) == (1, {Why.ELSEWHEN: 40})


def test_who_is_on_the_ground_is_left_out_unless_asked_for(tmp_path: Path) -> None:
    content = text(straight()).replace(HEADER, "time,icao24,lat,lon,onground").replace("TST101", "False")
    content = content.replace("False\n", "True\n", 10)
    assert dropped(read(tmp_path, content)) == {Why.GROUND: 10}
    assert dropped(read(tmp_path, content, Selection(ground=True))) == {}


def test_a_part_may_be_selected(tmp_path: Path) -> None:
    rows = text([*straight(), *straight("abc002", "TST202", y=-9.0, n=30)])
    at = Selection.of("2024-05-01T12:01:00Z", 2, None, ground=False)
    part = read(tmp_path, rows, at)
    assert (part.seconds, dropped(part)) == (100, {Why.OUTSIDE: 35 + 12})
    assert dropped(read(tmp_path, rows, Selection.of(None, 2, "1", ground=False))) == {Why.OUTSIDE: 40, Why.FEW: 25}
    named = read(tmp_path, rows, Selection.of(None, None, "tst202", ground=False))
    assert (named.aircraft, dropped(named)) == (1, {Why.FEW: 60})
    with pytest.raises(BadInput, match=r"--aircraft abc00: .*has no such aircraft near the radar, but abc00"):
        read(tmp_path, rows, Selection.of(None, None, "abc00", ground=False))
    with pytest.raises(BadInput, match="--start noon: must be UTC"):
        Selection.of("noon", None, None, ground=False)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "is empty: must have a header, such as time,icao24,lat,lon"),
        (HEADER + "\n", "0 rows were read"),
        ("1,2,3\n4,5,6\n", "if the table has no header, put one before it"),
        (HEADER.replace(",", " ") + "\n", "columns must be divided by commas"),
        (text(straight()).replace("lat,lon", "lon,lat"), "latitude and longitude may be swapped: so 60 rows"),
        (text(straight()[:1]), "1 the only position of a flight (row 2)"),
        (text([row._replace(lat=-row.lat) for row in straight()]), "60 farther than --range from the radar"),
        (text(straight()).replace("17145", "noon"), "60 a value cannot be read (rows 2 .. 61: time = 'noon64800'"),
        (b"\x04\x22\x4d\x18\0\0\0", "is compressed with LZ4: decompress it first, lz4 -d p.csv"),
        (gzip.compress(gzip.compress(b"", mtime=0), mtime=0), "is compressed twice: decompress it once"),
        (bytes(257) + b"ustar\0" + bytes(249), "is a tar archive: unpack it, tar -xf p.csv, and name the folder"),
        (b"\xd4\xc3\xb2\xa1\0\0\0", "is a capture of 0 packets without ASTERIX in UDP: it is empty"),
        (b"SQLite format 3\0", "is an SQLite database: export the table of positions as CSV"),
    ],
)
def test_an_empty_sky_says_why(content: str | bytes, words: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput) as caught:
        read(tmp_path, content)
    assert words in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("kind", ["pipe", "/dev/zero"])
def test_what_is_no_regular_file_is_not_read(kind: str, tmp_path: Path) -> None:
    """A pipe can be read once, and a device has no end."""
    file = tmp_path / kind  # of /dev/zero that alone
    if not file.exists():
        os.mkfifo(file)
    with pytest.raises(BadInput, match="not a regular file: save into one what it gives"):
        recorded(file, PLACE, RANGE_KM)


def test_a_radar_at_the_date_line_sees_both_sides(tmp_path: Path) -> None:
    place = Place(-17.0, 179.9, 0.0)
    places = [place.position(30.0, 0.8 * i - 20.0) for i in range(60)]
    lines = [f"{5 * i},abc,{lat},{lon % 360.0 if i % 2 else lon}" for i, (lat, lon) in enumerate(places)]
    (tmp_path / "p.csv").write_text("\n".join(["time,hex,lat,lon", *lines]))
    found = recorded(tmp_path / "p.csv", place, RANGE_KM)
    assert dropped(found) == {}
    np.testing.assert_allclose(speeds(found), 0.16, atol=0.001)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_row_is_kept_or_counted(data: st.DataObject, tmp_path: Path) -> None:
    """Whatever is done to some rows, the aircraft stays, and no row that was left alone is an outlier."""
    rows = straight()
    touched = data.draw(st.sets(st.integers(0, 59).map(lambda i: i // 3 * 3), max_size=6))
    for i in touched:
        row = rows[i]
        changed = [row._replace(t=row.t - 1e6), row._replace(aircraft=""), row._replace(lat=0.0, lon=0.0)]
        changed += [row._replace(lat=lat) for lat in (row.lat + 0.6, float("nan"), 95.0)]
        rows[i] = data.draw(st.sampled_from([*changed, row._replace(lon=row.lon + 0.05)]))
    found = read(tmp_path, text(rows))
    assert (found.aircraft, len(found.targets)) == (1, 1)
    assert found.tally.kept >= 60 - 2 * len(touched)
    assert speeds(found).max() < 0.4
