"""Formats of the field: one flight, written as each of them has it, is one flight again."""

import gzip
import json
import math
import re
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import asterix.generated as categories
import numpy as np
import pandas
import pytest

from cogradar.services.errors import BadInput
from cogradar.services.skies.place import Place
from cogradar.services.skies.recorded import Recording, recorded

PLACE, RANGE_KM = Place(48.35, 11.79, 60.0), 100.0
BEGIN_S, N, STEP_S = 1_714_564_800, 40, 5
MIDNIGHT_S = BEGIN_S % 86_400
FEET, METRES = 30_000, 9144.0
FLIGHT = [PLACE.position(20.0 + i, 5.0) for i in range(N)]  # 0.2 km/s
TIMES = [BEGIN_S + STEP_S * i for i in range(N)]


def check(found: Recording, *, height_km: float | None = METRES / 1e3, km: float = 0.02, kept: int = N) -> None:
    """It is the flight: where, when and how high."""
    (target,) = found.targets
    rows = np.array(target["trajectory"])
    assert (len(rows), found.tally.kept, found.aircraft) == (kept, kept, 1)
    np.testing.assert_allclose(rows[:, 1], 24.0 + 0.2 * rows[:, 0], atol=km)
    np.testing.assert_allclose(rows[:, 2], 5.0, atol=km)
    np.testing.assert_allclose(np.diff(rows[:, 0]), STEP_S, atol=0.01)
    if height_km is not None:
        np.testing.assert_allclose(rows[:, 3], height_km, atol=0.02)


def of_opensky(tmp_path: Path) -> Path:
    """State vectors of its archive: a row a second, the position being older; the last rows repeat it."""
    header = (
        "time,icao24,lat,lon,velocity,heading,vertrate,callsign,onground,alert,spi,squawk,baroaltitude,geoaltitude,"
        "lastposupdate,lastcontact"
    )
    rows = [
        f"{t + late},3c6444,{lat},{lon},200,60,0,DLH123  ,False,False,False,1000,{METRES},{METRES + 5},{t}.0,{t}.5"
        for t, (lat, lon) in zip(TIMES, FLIGHT, strict=True)
        for late in (0, 1)
    ]
    (tmp_path / "states_2024-05-01-12.csv.gz").write_bytes(gzip.compress("\n".join([header, *rows]).encode()))
    return tmp_path / "states_2024-05-01-12.csv.gz"


def of_opensky_rest(tmp_path: Path) -> Path:
    documents = [
        {
            "time": t,
            "states": [
                ["3c6444", "DLH123  ", "Germany", t, t, lon, lat, METRES, False, 200.0, 60.0, 0, None, METRES, None]
            ],
        }
        for t, (lat, lon) in zip(TIMES, FLIGHT, strict=True)
    ]
    (tmp_path / "states.jsonl").write_text("\n".join(map(json.dumps, documents)))
    return tmp_path / "states.jsonl"


def of_snapshots(tmp_path: Path) -> Path:
    """aircraft.json of readsb, one a file; of another aircraft there is no position."""
    folder = tmp_path / "history"
    folder.mkdir()
    for i, (t, (lat, lon)) in enumerate(zip(TIMES, FLIGHT, strict=True)):
        heard = {"hex": "3c6444", "flight": "DLH123  ", "alt_baro": FEET, "gs": 389.0, "lat": lat, "lon": lon}
        document = {"now": t + 0.7, "messages": 1, "aircraft": [heard | {"seen_pos": 0.7}, {"hex": "abc001"}]}
        (folder / f"history_{i:03}.json").write_text(json.dumps(document))
    return folder


def of_trace(tmp_path: Path) -> Path:
    """trace_full_*.json of tar1090, which is compressed without saying so."""
    entries = [
        [STEP_S * i, lat, lon, FEET, 389.0, 60.0, 0, 0, {"flight": "DLH123"} if i % 4 == 0 else None, "adsb_icao"]
        for i, (lat, lon) in enumerate(FLIGHT)
    ]
    document = {"icao": "3c6444", "r": "D-ABCD", "timestamp": BEGIN_S, "trace": entries}
    (tmp_path / "trace_full_3c6444.json").write_bytes(gzip.compress(json.dumps(document).encode()))
    return tmp_path / "trace_full_3c6444.json"


def table() -> pandas.DataFrame:
    """As the package `traffic` has it."""
    return pandas.DataFrame(
        {
            "timestamp": pandas.to_datetime(TIMES, unit="s", utc=True),
            "icao24": "3c6444",
            "callsign": "DLH123",
            "latitude": [lat for lat, _ in FLIGHT],
            "longitude": [lon for _, lon in FLIGHT],
            "altitude": [math.nan if i % 7 == 3 else float(FEET) for i in range(N)],
            "geoaltitude": float(FEET) + 200.0,
            "groundspeed": 389.0,
            "onground": False,
        }
    )


def of_parquet(tmp_path: Path) -> Path:
    table().to_parquet(tmp_path / "flights.parquet")
    return tmp_path / "flights.parquet"


def of_records(tmp_path: Path) -> Path:
    table().to_json(tmp_path / "flights.json", orient="records", date_format="iso")
    return tmp_path / "flights.json"


def of_sbs(tmp_path: Path) -> Path:
    lines = list[str]()
    for t, (lat, lon) in zip(TIMES, FLIGHT, strict=True):
        at = datetime.fromtimestamp(t, UTC).strftime("%Y/%m/%d,%H:%M:%S.000")
        lines.append(f"MSG,3,1,1,3C6444,1,{at},{at},,{FEET},,,{lat},{lon},,,0,0,0,0")
        lines.append(f"MSG,4,1,1,3C6444,1,{at},{at},,,389,60,,,0,,,,,0")
    (tmp_path / "sbs.txt").write_text("\r\n".join(lines))
    return tmp_path / "sbs.txt"


def of_flightradar(tmp_path: Path) -> Path:
    lines = ["Timestamp,UTC,Callsign,Position,Altitude,Speed,Direction"]
    for t, (lat, lon) in zip(TIMES, FLIGHT, strict=True):
        utc = datetime.fromtimestamp(t, UTC).isoformat()
        lines.append(f'{t},{utc},DLH123,"{lat},{lon}",{FEET},389,60')
    (tmp_path / "DLH123.csv").write_text("\n".join(lines))
    return tmp_path / "DLH123.csv"


def block(category: int, record: Any) -> bytes:
    kind = {
        21: categories.Cat_021_2_6,
        34: categories.Cat_034_1_29,
        48: categories.Cat_048_1_32,
        62: categories.Cat_062_1_20,
    }[category]
    return bytes(kind.create([kind.cv_record.create(record)]).unparse().to_bytes())


SOURCE = {"010": (("SAC", 25), ("SIC", 7))}


def degrees(lat: float, lon: float, bits: int) -> tuple[tuple[str, Any], ...]:
    half = 2.0 ** (bits - 1) / 180.0
    return ("LAT", round(lat * half)), ("LON", round(lon * half))


def of_asterix(category: int) -> Callable[[Path], Path]:
    """A recording that passes midnight; of the radar's category from a radar 30 km to the east."""
    radar = Place(*Place(48.35, 11.79, 90.0).position(30.0, 0.0), 0.0)

    def make(tmp_path: Path) -> Path:
        data = b""
        for i, (lat, lon) in enumerate(FLIGHT):
            tod = round(128 * ((86_300 + STEP_S * i) % 86_400))
            if category == 21:
                data += block(
                    21,
                    SOURCE
                    | {"071": tod, "131": degrees(lat, lon, 31), "080": 0x3C6444, "140": round(FEET / 6.25)}
                    | {"040": ((("ATP", 0), ("ARC", 0), ("RC", 0), ("RAB", 0), None),)},
                )
            elif category == 62:
                data += block(
                    62,
                    SOURCE
                    | {
                        "070": tod,
                        "105": degrees(lat, lon, 26),
                        "040": 17,
                        "136": FEET // 25,
                        "080": ((*(("MON", 0), ("SPI", 0), ("MRH", 0), ("SRC", 0), ("CNF", 0)), None),),
                    },
                )
            else:
                data += block(
                    34,
                    SOURCE | {"000": 1, "030": tod, "120": (("HGT", 0), *degrees(radar.latitude, radar.longitude, 24))},
                )
                x, y = radar.seen(lat, lon)
                slant_nm, theta = math.hypot(x, y, METRES / 1e3) / 1.852, math.degrees(math.atan2(y, x)) % 360.0
                polar = ("RHO", round(slant_nm * 256)), ("THETA", round(theta * 65_536 / 360.0))
                data += block(
                    48,
                    SOURCE
                    | {"140": tod, "040": polar, "090": (("V", 0), ("G", 0), ("FL", FEET // 25)), "220": 0x3C6444},
                )
        (tmp_path / "recording.ast").write_bytes(data)
        return tmp_path / "recording.ast"

    return make


@pytest.mark.parametrize(
    ("write", "form"),
    [
        (of_opensky, "text, commas, utf-8"),
        (of_opensky_rest, "JSON, states of OpenSky"),
        (of_snapshots, "JSON, snapshot of readsb; 40 files"),
        (of_trace, "JSON, trace of readsb"),
        (of_parquet, "Parquet"),
        (of_records, "JSON, records"),
        (of_sbs, "BaseStation (SBS)"),
        (of_flightradar, "text, commas, utf-8"),
        (of_asterix(21), "ASTERIX, categories 021"),
        (of_asterix(48), "ASTERIX, categories 034, 048"),
        (of_asterix(62), "ASTERIX, categories 062"),
    ],
)
def test_a_flight_is_read_from_each_format(write: Callable[[Path], Path], form: str, tmp_path: Path) -> None:
    found = recorded(write(tmp_path), PLACE, RANGE_KM, heights=True)
    check(found, km=0.12 if "048" in form else 0.02)
    assert found.tally.form == form
    assert found.begin_utc == (None if "ASTERIX" in form else "2024-05-01T12:00:20Z")


@pytest.mark.parametrize(
    ("write", "library", "words"),
    [
        (of_parquet, "pyarrow", "Parquet needs pyarrow: pip install 'cogradar[parquet]'"),
        (of_asterix(62), "asterix", "ASTERIX needs libasterix: pip install 'cogradar[asterix]'"),
    ],
)
def test_a_library_that_is_missing_is_named(
    write: Callable[[Path], Path], library: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write(tmp_path)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(BadInput, match=re.escape(words)):
        recorded(file, PLACE, RANGE_KM)


def test_what_is_cut_short_is_used_up_to_there(tmp_path: Path) -> None:
    for write in (of_asterix(62), of_opensky_rest, of_sbs):
        file = write(tmp_path)
        file.write_bytes(file.read_bytes()[:-17])
        check(recorded(file, PLACE, RANGE_KM), height_km=None, kept=N if write is of_sbs else N - 1)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            '{"type": "FeatureCollection", "features": []}',
            "is JSON, but nothing that is known: must be an aircraft.json",
        ),
        ('[{"lat": 1, "lon": 2}]', "its records have no column for the time"),
        ("[1, 2", "no JSON file: "),
        ("[" * 100_000, "no JSON file: "),
        ("PAR1 and so on", "no Parquet file: "),
        (b"\x3e\x00\x02\xff\xff", "no ASTERIX: its first block has no valid length"),
    ],
)
def test_files_that_are_none_of_a_format(content: str | bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "f").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(BadInput) as caught:
        recorded(tmp_path / "f", PLACE, RANGE_KM)
    assert words in str(caught.value)
    assert str(caught.value).isprintable()
