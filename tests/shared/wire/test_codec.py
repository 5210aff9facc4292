"""Bytes of messages: every message survives, equal messages give equal bytes, and nothing but BadMessage is raised."""

import re
from contextlib import suppress
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cogradar.shared.protocol.fields import FAR, LARGEST, MAX_CELLS, MAX_HISTORY, MAX_PARTICLES, MAX_SIDE
from cogradar.shared.protocol.messages import (
    SCHEMA,
    Checkpoint,
    Command,
    EmulatorCheckpoint,
    Message,
    Plan,
    RunCancel,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from cogradar.shared.protocol.orders import (
    LEAST_POWER,
    MAX_LOOK_DWELLS,
    MAX_LOOKS,
    DropTrack,
    EndRun,
    Look,
    Order,
    PowerLimit,
    SectorSearch,
)
from cogradar.shared.protocol.recovery import (
    Handover,
    History,
    NoPlans,
    NoWaveforms,
    ScanRecall,
    Snapshot,
    WaveformRecall,
)
from cogradar.shared.protocol.topics import BY_NAME
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import MAX_BYTES, MAX_LOT, BadMessage, decode, encode, join, split
from tests.samples import FIELDS, SMOKE, plan, sample

PATIENT = settings(suppress_health_check=[HealthCheck.too_slow])  # a loaded machine is no error

RUN = st.from_regex(r"\A[A-Za-z0-9][A-Za-z0-9_.-]{0,63}\Z")
INDEX = st.integers(0, 2**31 - 1)
SIZE = st.integers(1, 5)
HEAD = {"run": RUN, "k": INDEX, "t": INDEX}


def floats(shape: Any, dtype: str = "f8") -> st.SearchStrategy[Any]:
    most = {} if dtype == "c8" else {"min_value": -LARGEST, "max_value": LARGEST}
    return hnp.arrays(dtype, shape, elements={"allow_nan": False, "allow_infinity": False} | most)


def states(n: int) -> st.SearchStrategy[Any]:
    return hnp.arrays("f8", (n, 4), elements={"min_value": -FAR, "max_value": FAR})


def bins(n: int | tuple[int, int], low: int = 0) -> st.SearchStrategy[Any]:
    return hnp.arrays("i4", n, elements={"min_value": low, "max_value": 2**31 - 1})


def cells_lit(n_track: int, cells: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray[Any, Any]]:
    """Some different ones for each track, -1 behind them."""
    row = st.lists(cells, max_size=MAX_CELLS, unique=True).map(lambda row: row + [-1] * (MAX_CELLS - len(row)))
    return st.lists(row, min_size=n_track, max_size=n_track).map(lambda rows: np.array(rows, "i4"))


def scans(n: int) -> st.SearchStrategy[Message]:
    least = 2 / LARGEST  # a statistic needs a sigma_hat
    positive = hnp.arrays("f8", n, elements={"min_value": least, "max_value": LARGEST})
    columns = dict.fromkeys(("statistic", "sigma_hat", "signature_power"), positive)
    ascending = st.lists(INDEX, min_size=n, max_size=n, unique=True).map(lambda b: np.array(sorted(b), "i4"))
    return ascending.flatmap(
        lambda looked: st.builds(
            Scan,
            **HEAD,
            bins=st.just(looked),
            alpha_hat=floats(n, "c8"),
            beams=SIZE.flatmap(lambda m: cells_lit(m, st.sampled_from(looked.tolist()))),
            **columns,
        )
    )


def plans() -> st.SearchStrategy[Message]:
    cells = st.lists(st.integers(0, MAX_SIDE), min_size=1, max_size=MAX_CELLS, unique=True)
    asked: st.SearchStrategy[tuple[str, list[int]]] = st.just(("searching", [])) | st.tuples(st.just("tracking"), cells)
    estimate = hnp.arrays("f8", 4, elements={"min_value": -FAR, "max_value": FAR})
    factor = hnp.arrays("f8", (4, 4), elements={"min_value": -FAR / 4, "max_value": FAR / 4})
    covariance = factor.map(lambda a: (a @ a.T + (a @ a.T).T) / 2)
    rest = {"target": INDEX, "range_km": st.floats(0, FAR), "estimate": estimate, "covariance": covariance}
    return asked.flatmap(
        lambda a: st.builds(
            Plan,
            **HEAD,
            **rest,
            detected=st.booleans(),
            depleted=st.booleans(),
            n_sim=INDEX,
            status=st.just(a[0]),
            bins=st.just(np.array(a[1], "i4")),
            chances=hnp.arrays("f8", len(a[1]), elements={"min_value": 0.0, "max_value": 1.0}),
            best_bin=st.just(a[1][0] if a[1] else -1),
            worth=st.floats(0, 1),
            reach=st.integers(0, MAX_SIDE),
            astray=st.booleans(),
            gain=st.floats(0, 1e30),
        )
    )


def snapshots(n: int, n_row: int, n_bin: int) -> st.SearchStrategy[Message]:
    looked = hnp.arrays("f8", (n_row, n_bin), elements={"min_value": 0.0, "max_value": LARGEST})
    return st.builds(
        Snapshot,
        run=RUN,
        k=INDEX,
        target=INDEX,
        detected=st.booleans(),
        depleted=st.booleans(),
        in_beam=st.booleans(),
        sigma_hat=st.floats(1e-9, 1e9),  # a detection has one
        level=st.floats(0, 1e9),
        power=st.just(0.0) | st.floats(1e-9, 1e9),
        belief=states(n),
        remembered=st.sampled_from([0, n]).flatmap(states),
        measured=floats((4,)),
        looked=looked,
        modes=floats((3,)),
        hit_bin=st.integers(-1, n_bin - 1),
        hit_amplitude=st.floats(0, 1e9),
        attempts=INDEX,
        existence=st.floats(0, 1),
        log_evidence=st.floats(-1e9, 1e9),
    )


SEEDS = st.integers(0, 2**63 - 1)
SETTINGS: dict[str, st.SearchStrategy[Any]] = {
    "run": RUN,
    "strategy": st.sampled_from(Strategy),
    "seed": SEEDS,
    "dwells": st.integers(5, 10**6),
}
SIDE = st.floats(-90.0, 0.0)
ACTIONS: st.SearchStrategy[Any] = st.one_of(
    st.builds(PowerLimit, share=st.floats(LEAST_POWER, 1.0)),
    st.builds(SectorSearch, from_deg=SIDE, to_deg=st.floats(0.01, 90.0), search=st.sampled_from(("blank", "double"))),
    st.builds(Look, bearing_deg=SIDE, dwells=st.integers(1, MAX_LOOK_DWELLS), share=st.floats(LEAST_POWER, MAX_LOOKS)),
    st.builds(DropTrack, track=INDEX),
    st.just(EndRun()),
)
ORDERS = st.lists(st.builds(Order, n=st.integers(1, 2**31 - 1), k=INDEX, action=ACTIONS), max_size=4)
PROGRESS = SETTINGS | {
    "orders": ORDERS,
    "radar": st.just(SMOKE["radar"]),
    "k": st.integers(5, 2**31 - 1),
    "t": st.integers(0, 5),  # never more than k or dwells
    "ended": st.booleans(),
}
MESSAGES: dict[type[Message], st.SearchStrategy[Message]] = {
    RunStart: st.builds(RunStart, **SETTINGS, scenario=st.just(SMOKE)),
    Checkpoint: st.builds(Checkpoint, **PROGRESS),
    EmulatorCheckpoint: st.builds(
        EmulatorCheckpoint, **PROGRESS, world=st.sampled_from([None, SMOKE["world"]]), world_seed=SEEDS
    ),
    RunCancel: st.builds(RunCancel, run=RUN, reason=st.text(max_size=500)),
    Command: st.builds(
        Command,
        run=RUN,
        id=st.from_regex(r"[0-9a-f]{32}", fullmatch=True),
        by=st.text("abcz. -~", min_size=1, max_size=100),
        action=ACTIONS,
        at=INDEX,
    ),
    Snapshot: st.tuples(SIZE, SIZE, SIZE).flatmap(lambda sizes: snapshots(*sizes)),
    ScanRecall: st.builds(ScanRecall, run=RUN, k=INDEX, targets=st.lists(INDEX, min_size=1, unique=True), planner=RUN),
    **{
        unable: st.builds(unable, run=RUN, process=RUN, reason=st.text(min_size=1, max_size=400), ends=st.booleans())
        for unable in (NoPlans, NoWaveforms)
    },
    Handover: st.builds(
        Handover, run=RUN, planner=RUN, k=INDEX, targets=st.lists(INDEX, min_size=1, unique=True), taken=st.booleans()
    ),
    WaveformRecall: st.builds(WaveformRecall, run=RUN, k=INDEX),
    History: st.builds(
        History,
        to=RUN,
        run=RUN,
        topic=st.sampled_from(["scan", "plan", "waveform", "snapshot"]),
        k=INDEX,
        payloads=st.lists(st.binary(max_size=50), max_size=MAX_HISTORY),
    ),
    Scan: SIZE.flatmap(scans),
    Truth: SIZE.flatmap(
        lambda m: st.builds(
            Truth,
            **HEAD,
            states=floats((m, 4)),
            bins=bins(m, 0),
            snr_db=floats(m),
            heights_km=floats(m),
            waveform_k=INDEX,
        )
    ),
    Plan: plans(),
    Waveform: SIZE.flatmap(
        lambda m: st.builds(
            Waveform,
            run=RUN,
            k=INDEX,
            tracking=st.just(True),
            isotropic=st.floats(0, 1e9),
            factor=floats((3, m), "c8"),
            beams=bins((m, 1)),
            shares=hnp.arrays("f8", (m, 1), elements=st.floats(0, 1e9)),
            late=bins(m),
            status=st.sampled_from(["fixed", "optimal", "inaccurate"]),
            orders=st.none() | bins(2),
        )
    ),
    RunEnd: st.builds(RunEnd, **HEAD, status=st.sampled_from(["complete", "failed"]), reason=st.text(max_size=500)),
}
ANY = st.one_of(*MESSAGES.values())


def refused(payload: bytes) -> str:
    """Reason for which a payload is refused."""
    with pytest.raises(BadMessage) as caught:
        decode(payload)
    assert_one_short_line(str(caught.value))
    return str(caught.value)


def assert_one_short_line(text: str) -> None:
    assert text.isprintable()
    assert 0 < len(text) <= 200


def decode_or_refuse(payload: bytes) -> None:
    """Whatever the bytes, there is a message or a BadMessage: any other exception fails the test."""
    try:
        message = decode(payload)
    except BadMessage as bad:
        assert_one_short_line(str(bad))
    else:
        assert isinstance(message, Message)


def ext(value: Any) -> msgpack.ExtType:
    """Array as the wire has it: dtype name, number of axes, their lengths, elements; all little-endian."""
    array = np.asarray(value)
    shape = np.array(array.shape, "<u4").tobytes()
    return msgpack.ExtType(
        1, {"i": b"i4", "f": b"f8", "c": b"c8"}[array.dtype.kind] + bytes([array.ndim]) + shape + array.tobytes()
    )


PLAN = {name: ext(value) if isinstance(value, np.ndarray) else value for name, value in FIELDS[Plan].items()}


def envelope(topic: Any = "plan", body: Any = None, v: Any = SCHEMA) -> bytes:
    payload: bytes = msgpack.packb({"v": v, "topic": topic, "body": body})
    return payload


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
@settings(PATIENT, max_examples=40)
@given(data=st.data())
def test_round_trip(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(MESSAGES[kind])
    payload = encode(message)
    back = decode(payload)
    assert back == message  # bit for bit, arrays included
    assert encode(back) == payload


def test_every_topic_is_covered() -> None:
    assert set(MESSAGES) == set(FIELDS) == {topic.message for topic in BY_NAME.values()}


def test_bytes_of_a_plan() -> None:
    """Written out by hand: the wire format is a contract between versions, digests depend on it."""
    head = {"run": "run-1", "k": 3, "t": 1, "target": 1, "status": "tracking"}
    bins, chances = b"i4\x01\x01\x00\x00\x00\x05\x00\x00\x00", b"f8\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\xf0\x3f"
    cells = {"bins": msgpack.ExtType(1, bins), "chances": msgpack.ExtType(1, chances), "best_bin": 5}
    body = {**head, **cells, "worth": 0.0, "gain": 0.0, "range_km": 63.2}
    estimate = b"f8\x01\x04\x00\x00\x00" + 4 * b"\x00\x00\x00\x00\x00\x00\xf0\x3f"  # IEEE 754 of 1.0, little-endian
    covariance = b"f8\x02\x04\x00\x00\x00\x04\x00\x00\x00" + 16 * bytes(8)
    state = {"estimate": msgpack.ExtType(1, estimate), "covariance": msgpack.ExtType(1, covariance)}
    whole = {**body, **state, "detected": False, "depleted": False, "reach": 0, "astray": False, "n_sim": 0}
    assert encode(plan()) == msgpack.packb({"v": 2, "topic": "plan", "body": whole})


def test_the_largest_snapshot_is_a_message_that_a_history_can_carry() -> None:
    """All particles twice, the most misses that are remembered and the finest grid that a scenario may have."""
    many = np.ones((MAX_PARTICLES, 4))
    largest = encode(sample(Snapshot, belief=many, remembered=many, looked=np.ones((1 + 100, 1024))))
    assert len(encode(sample(History, topic="snapshot", payloads=[largest]))) <= MAX_BYTES


def test_bytes_do_not_depend_on_how_a_message_was_made() -> None:
    fields = {"run": "r", **FIELDS[Scan]}
    turned = dict(reversed(fields.items()))
    strided = {**fields, "statistic": np.repeat(fields["statistic"], 2)[::2]}
    assert encode(Scan(**fields)) == encode(Scan(**turned)) == encode(Scan(**strided))
    factor = np.asfortranarray(np.arange(6, dtype=np.complex64).reshape(3, 2))
    waveform, ordered = (sample(Waveform, factor=f) for f in (factor, np.ascontiguousarray(factor)))
    assert encode(waveform) == encode(ordered)
    shuffled = sample(RunStart, scenario=dict(reversed(SMOKE.items())))
    assert encode(shuffled) == encode(sample(RunStart))


def test_arrays_arrive_as_kernels_need_them() -> None:
    """Writeable, aligned and contiguous, or Numba compiles each kernel once more."""
    for kind in FIELDS:
        for value in vars(decode(encode(sample(kind)))).values():
            if isinstance(value, np.ndarray):
                assert value.flags.writeable
                assert value.flags.aligned
                assert value.flags.c_contiguous


@settings(PATIENT, max_examples=150)
@given(payload=st.binary(max_size=200))
def test_noise(payload: bytes) -> None:
    decode_or_refuse(payload)


@settings(PATIENT, max_examples=150)
@given(message=ANY, data=st.data())
def test_changed_cut_and_lengthened_bytes(message: Message, data: st.DataObject) -> None:
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 5))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    decode_or_refuse(bytes(payload))
    whole = encode(message)
    refused(whole[: data.draw(st.integers(0, len(whole) - 1))])
    refused(whole + b"\0")


@pytest.mark.parametrize("depth", [500, 1000, 2000, 200_000])
def test_deep_nesting(depth: int) -> None:
    deep = b"\x91" * depth + b"\x01"
    refused(deep)
    start = msgpack.packb({"v": 1, "topic": "runstart", "body": {"run": "r", "scenario": 1, "seed": 1, "dwells": 1}})
    refused(start.replace(b"\xa8scenario\x01", b"\xa8scenario" + deep))


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "not MessagePack"),
        (b"\xc1", "not MessagePack"),
        (msgpack.packb([1, 2]), "not an envelope of v, topic and body"),
        (msgpack.packb({"v": 1, "topic": "plan"}), "not an envelope of v, topic and body"),
        (envelope(v=1), "schema 1, expected 2"),
        (envelope(v=True), "schema True, expected 2"),
        (envelope(v=1.0), "schema 1.0, expected 2"),
        (envelope("pla\nn"), r"unknown topic 'pla\nn'"),
        (envelope(["plan"]), "unknown topic ['plan']"),
        (envelope("plan", []), "plan: the body is not a map"),
        (envelope("plan", {"run": "r\n"}), "plan.run: String should match pattern"),
        (
            envelope("plan", {**PLAN, "run": "r", "estimate": ext(np.zeros(3))}),
            "plan.estimate: must be",
        ),
        (
            envelope("runstart", {"run": "r", "strategy": "uniform", "dwells": 1, "scenario": {}}),
            "runstart.scenario: scenario: ",
        ),
        (envelope(body=msgpack.ExtType(2, b"f8\x00")), "extension type 2 of 3 bytes is not an array"),
        (envelope(body=msgpack.ExtType(1, b"f4\x00")), "array of a kind that is never sent"),
        (envelope(body=msgpack.ExtType(1, b"f8\x03" + 12 * b"\0")), "array of a kind that is never sent"),
        (envelope(body=msgpack.ExtType(1, b"f8\x02" + 8 * b"\xff")), "does not fit its 11 bytes"),
        (b"\0" * (MAX_BYTES + 1), f"{MAX_BYTES + 1} bytes, more than {MAX_BYTES}"),
    ],
)
def test_reasons(payload: bytes, reason: str) -> None:
    assert reason in refused(payload)


@settings(PATIENT, max_examples=50)
@given(messages=st.lists(ANY, min_size=1, max_size=4))
def test_messages_that_travel_together_come_apart_again(messages: list[Message]) -> None:
    payloads = [encode(message) for message in messages]
    assert split(join(payloads)) == payloads
    assert join(payloads[:1]) == payloads[0]


@settings(PATIENT, max_examples=200)
@given(payload=st.binary(min_size=1, max_size=80), first=st.sampled_from([0x90, 0x91, 0x9F, 0xDC, 0xDD]))
def test_noise_that_claims_to_be_several_messages(payload: bytes, first: int) -> None:
    for noise in (payload, bytes([first]) + payload):
        with suppress(BadMessage):
            parts = split(noise)
            assert 0 < len(parts) <= MAX_LOT
            assert all(isinstance(part, bytes) for part in parts)


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (msgpack.packb([]), "not a lot of 1 .. 64 messages"),
        (msgpack.packb([b"a"] * (MAX_LOT + 1)), "not a lot of 1 .. 64 messages"),
        (msgpack.packb([b"a", 1]), "not a lot of 1 .. 64 messages"),
        (msgpack.packb([b"a", b"b"])[:-1], "not MessagePack"),
        (b"\x91" * 2000 + b"\x01", "not MessagePack"),
        (msgpack.packb([b"\0" * MAX_BYTES]), f"more than {MAX_BYTES}"),
    ],
)
def test_reasons_to_refuse_a_lot(payload: bytes, reason: str) -> None:
    with pytest.raises(BadMessage, match=re.escape(reason)):
        split(payload)


def test_the_largest_message_there_is_fits() -> None:
    """A factor of 512 x 512, the largest array a scenario may have, and one that is too long."""
    largest = sample(Waveform, factor=np.ones((512, 512), np.complex64))
    assert decode(encode(largest)) == largest
    with pytest.raises(ValueError, match=f"longer than {MAX_BYTES}"):
        encode(sample(Waveform, factor=np.ones((MAX_SIDE, 512), np.complex64)))
