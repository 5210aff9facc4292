"""Whole runs for viewers: read by the formats' own readers, and checked against the schemas of those who draw them."""

import json
import subprocess
import sys
import tracemalloc
from itertools import cycle, islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import jsonschema
import numpy as np
import pytest
from foxglove_schemas_protobuf import FrameTransform_pb2, GeoJSON_pb2, SceneUpdate_pb2
from google.protobuf.json_format import ParseDict
from mcap.reader import make_reader

import cogradar
from cogradar.services.analysis.export import formats, mcap_file, rrd_file
from cogradar.services.analysis.export.scene import attitude

BEGIN_S, LATITUDE, LONGITUDE, BORESIGHT = 1767225600.0, 48.0, 11.0, 90.0
SITE = {
    "site.latitude_deg": LATITUDE,
    "site.longitude_deg": LONGITUDE,
    "site.boresight_deg": BORESIGHT,
    "site.begin_utc": "2026-01-01T00:00:00Z",
}
KINDS = {
    "bins": {},
    "placed": SITE,
    "unknown": SITE | {"radar.fidelity": "best-range", "radar.tracks": "unknown"},
}
FOXGLOVE = {
    "foxglove.SceneUpdate": SceneUpdate_pb2.SceneUpdate,
    "foxglove.FrameTransform": FrameTransform_pb2.FrameTransform,
    "foxglove.GeoJSON": GeoJSON_pb2.GeoJSON,
}


@pytest.fixture(scope="module", params=KINDS)
def result(request: pytest.FixtureRequest) -> cogradar.Result:
    return cogradar.run("smoke", set=KINDS[request.param], dwells=14, seed=3)


@pytest.fixture(scope="module")
def messages(result: cogradar.Result, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, str, int, Any]]:
    """Topic, name of the schema, time in ns and content of all, which fit their schemas."""
    file, found = tmp_path_factory.mktemp("mcap") / "run.mcap", []
    assert formats.write(result, file) == f"{len(list(result.dwells()))} dwells"
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        (metadata,) = reader.iter_metadata()
        assert metadata.metadata["digest"] == result.digest
        assert json.loads(metadata.metadata["scenario"]) == result.scenario.model_dump(mode="json")
        summary = reader.get_summary()
        assert summary is not None
        validators = {i: jsonschema.Draft202012Validator(json.loads(one.data)) for i, one in summary.schemas.items()}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            content = json.loads(message.data)
            validators[schema.id].validate(content)
            found.append((channel.topic, schema.name, message.log_time, content))
    return found


def test_tables_of_an_mcap_file_are_those_of_the_run(result: cogradar.Result, messages: list[Any]) -> None:
    tables = {
        "/looks": result.detections(all_looks=True),
        "/plans": result.requests(),
        "/truth": result.truth(),
        "/tracks": result.tracks(),
    }
    for topic, table in tables.items():
        rows = [row for name, _, _, content in messages if name == topic for row in content["rows"]]
        assert len(rows) == len(table) > 0
        columns = table.columns() | {name: table[name] for name in ("covariance",) if topic == "/tracks"}
        for name, values in columns.items():
            if name.startswith("covariance_") or (topic, name) == ("/tracks", "target"):
                continue  # which target a track follows is known at the end only
            theirs = [row.get(name, np.nan) for row in rows]
            assert np.array_equal(np.reshape(theirs, values.shape), values, equal_nan=values.dtype.kind == "f"), name
    sent = [content["rows"][0] for name, _, _, content in messages if name == "/waveform"]
    factor = np.array(sent[-1]["factor_real"]) + 1j * np.array(sent[-1]["factor_imag"])
    ours = result.waveforms()[-1]["factor"]
    assert np.array_equal(factor.reshape(len(ours), -1), ours[:, : factor.size // len(ours)])


def test_what_is_drawn_is_what_foxglove_knows(result: cogradar.Result, messages: list[Any]) -> None:
    drawn = [(FOXGLOVE[schema], content) for _, schema, _, content in messages if schema in FOXGLOVE]
    for kind, content in drawn:
        ParseDict(_with_times(content), kind())  # raises for a field that it does not have, or of another type
    last = [content for topic, _, _, content in messages if topic == "/scene"][-1]
    (tracks,) = (entity for entity in last["entities"] if entity["id"] == "tracks")
    table = result.tracks()
    now = table[table["k"] == table["k"].max()]
    assert [text["text"] for text in tracks["texts"]] == [str(n) for n in now["track"]]
    assert [sphere["pose"]["position"] for sphere in tracks["spheres"]] == [
        {"x": row["x_hat"], "y": row["y_hat"], "z": 0.0} for row in now
    ]
    maps = [json.loads(content["geojson"]) for topic, _, _, content in messages if topic == "/map"]
    assert bool(maps) == (result.scenario.site is not None)
    for feature in maps[-1]["features"] if maps else ():
        longitude, latitude = feature["geometry"]["coordinates"]
        assert abs(latitude - LATITUDE) < 2.0
        assert 0.0 < longitude - LONGITUDE < 3.0  # before a radar that looks to the east


def _with_times(content: Any, name: str = "") -> Any:
    """In JSON of protobuf times are texts; viewers of JSON take seconds and nanoseconds."""
    match content:
        case {"sec": sec, "nsec": nsec}:
            stamp = np.datetime64(sec, "s") + np.timedelta64(nsec, "ns")
            return "0s" if name == "lifetime" else f"{stamp}Z"
        case dict():
            return {key: _with_times(value, key) for key, value in content.items()}
        case list():
            return [_with_times(one) for one in content]
        case _:
            return content


def test_dwells_are_at_the_times_of_the_run(result: cogradar.Result, messages: list[Any]) -> None:
    times = {content["k"]: at for topic, _, at, content in messages if topic == "/looks"}
    assert list(times.values()) == sorted(times.values())
    looks = result.detections(all_looks=True)
    if result.scenario.site is not None:
        for k, t in zip(looks["k"].tolist(), looks["t"].tolist(), strict=True):
            assert t == 0 or times[k] == round(1e9 * (BEGIN_S + t))
    else:
        assert times[0] == 0


def test_the_frame_turns_boresight_to_its_bearing(result: cogradar.Result) -> None:
    x, y, z, w = attitude(result.scenario)
    forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])  # of x, in the map
    right = np.array([2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)])  # of y
    bearing = np.radians(0.0 if result.scenario.site is None else BORESIGHT)
    assert forward == pytest.approx([np.sin(bearing), np.cos(bearing), 0.0], abs=1e-12)
    assert right == pytest.approx([np.cos(bearing), -np.sin(bearing), 0.0], abs=1e-12)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_longer_run_needs_no_more_memory(tmp_path: Path) -> None:
    played = cogradar.run("smoke", dwells=40)
    dwells, peaks = list(played.dwells()), dict[int, int]()

    def counted(n: int) -> None:
        if n in {300, 1500}:
            peaks[n] = tracemalloc.get_traced_memory()[1]

    names = ("run", "strategy", "seed", "digest", "scenario", "acquisition_scans")
    long = SimpleNamespace(
        **{name: getattr(played, name) for name in names}, dwells=lambda: islice(cycle(dwells), 1500)
    )
    tracemalloc.start()
    try:
        mcap_file.write(long, tmp_path / "run.mcap", counted)  # type: ignore[arg-type] # what it asks of a Result
    finally:
        tracemalloc.stop()
    assert peaks[1500] - peaks[300] < 1_000_000 < (tmp_path / "run.mcap").stat().st_size


def test_a_recording_has_one_timeline_of_times(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    played, rerun = cogradar.run("smoke", dwells=4), MagicMock()
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", rerun.blueprint)
    dwells = list(played.dwells())
    for dwell in dwells:
        dwell.scenario = dwell.scenario.model_copy(update={"world": None})
        if dwell.k % 2:
            dwell._said.scan = dwell._said.scan.model_copy(update={"utc_s": BEGIN_S + dwell.k})
    monkeypatch.setattr(played, "dwells", lambda: iter(dwells))
    rrd_file.write(played, tmp_path / "run.rrd", lambda _: None)
    calls = rerun.RecordingStream.return_value.set_time.call_args_list
    assert {call.args for call in calls} == {("dwell",), ("utc",)}
    times = [call.kwargs["timestamp"] for call in calls if call.args == ("utc",)]
    assert times == [BEGIN_S + dwell.k for dwell in dwells]


def test_rerun_reads_its_recording(result: cogradar.Result, tmp_path: Path) -> None:
    reading = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: pip install 'cogradar[rerun]'")
    file = tmp_path / "run.rrd"
    assert formats.write(result, file) == f"{len(list(result.dwells()))} dwells"
    subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", file], check=True, capture_output=True)
    found = dict[str, list[Any]]()
    for chunk in reading.RrdReader(file).stream():
        for name, column in chunk.to_record_batch().to_pydict().items():
            found.setdefault(f"{chunk.entity_path} {name}", []).extend(column)
    rows = result.tracks()
    rows = rows[rows["track"] == rows["track"].min()]
    shares = found[f"/share/track_{rows['track'][0]} Scalars:scalars"]
    assert [one for (one,) in shares] == rows["share"][np.isfinite(rows["share"])].tolist()
