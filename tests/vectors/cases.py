"""Each message in three sizes, as bytes and as JSON. The JSON is made from the message itself, not from its bytes."""

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import (
    SCHEMA,
    Checkpoint,
    Command,
    EmulatorCheckpoint,
    Lead,
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
    Accuracy,
    DropTrack,
    EndRun,
    Look,
    Order,
    Pause,
    PowerLimit,
    Priority,
    Resume,
    SectorSearch,
    Setting,
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
from cogradar.shared.protocol.roster import Compared, Roster
from cogradar.shared.protocol.topics import KINDS, name_of
from cogradar.shared.scenario.files import load
from cogradar.shared.wire.codec import encode
from tests.samples import sample

FILE = Path(__file__).with_name("messages.jsonl")
SIZES = ("smallest", "usual", "largest")
LAST, LONGEST = 2**31 - 1, "a." + "Z_9-" * 15 + "00"  # the longest name of a run
SKY = load("traffic").model_dump()
# Numbers at which an encoding changes its length.
EDGES = [0, 127, 128, 255, 256, 65_535, 65_536, LAST]
ACTIONS: list[Any] = [
    PowerLimit(share=0.5),
    SectorSearch(from_deg=-90.0, to_deg=-12.5, search="blank"),
    Look(bearing_deg=1e-3, dwells=100_000, share=0.01),
    DropTrack(track=LAST),
    Priority(track=128, weight=10.0),
    Accuracy(track=0, km=None),
    Setting(key="rule", value="mean"),
    Pause(),
    Resume(),
    EndRun(),
]


def _rows(n: int, *columns: float) -> Any:
    """A column of n numbers that need all digits of a double, or several; the same on every machine."""
    values = (2.0 * (np.arange(1.0, n + 1.0) * 0.6180339887498949 % 1.0) - 1.0)[:, np.newaxis] * np.array(
        columns or (1.0,)
    )
    return values if columns else values[:, 0]


def _roster(m: int) -> Roster:
    births = np.abs(_rows(2, 0.1, 5.0, 60.0, 0.1, 0.01, 3.0, 0.2, 7.0))
    return Roster(
        ids=np.arange(m, dtype=np.int32) * 3,
        next_id=3 * m,
        confirmed=np.arange(m, dtype=np.int32) % 2,
        born_k=np.arange(m, dtype=np.int32),
        births=births,
        expected=np.abs(_rows(m, 0.5, 0.01, 90.0, 0.3, 1.0)),
        searched=np.array([-0.5, -0.0, 0.25, 0.5]),
        next_search=2**48 - 1,
        search_share=0.1,
    )


def _looks(n: int, m: int) -> dict[str, Any]:
    """Fields of a scan of n steered looks at m tracks."""
    size = np.abs(_rows(n)) + 0.01
    return {
        "bins": np.arange(n, dtype=np.int32),
        "statistic": size * 40.0,
        "alpha_hat": (_rows(n) + 1j * size).astype(np.complex64),
        "sigma_hat": size,
        "signature_power": size * 7.0,
        "beams": np.arange(2 * m, dtype=np.int32).reshape(m, 2),
        "nus": np.linspace(-0.5, 0.5, n),
        "limits": size * 11.0,
        "ranges_km": size * 60.0,
        "nu_hats": _rows(n, 0.5)[:, 0],
        "nu_sigmas": size * 0.01,
        "beam_nus": _rows(m, 0.5, -0.25),
        "gates": np.array([[1e-3, 9e8]] * m),
        "roster": _roster(m),
    }


def _orders(n: int) -> list[Order]:
    return [Order(n=i + 1, k=EDGES[i % len(EDGES)], action=ACTIONS[i % len(ACTIONS)]) for i in range(n)]


EMPTY = np.empty(0)
NO_BINS = np.empty(0, np.int32)
FULL = {
    "radar": SKY["radar"],
    "k": LAST,
    "t": LAST,
    "rate_hz": 1000.0,
    "resend": True,
    "lacking": EDGES,
    "ended": True,
    "held": True,
    "overdue": EDGES[::-1],
    "orders": _orders(20),
    "leads": [Lead(epoch=2**62 - n, revision=n) for n in (7, 0)],
    "epoch": 2**62,
    "seed": 2**63 - 1,
}
# What is changed of the usual message for the smallest one, and for the largest.
CHANGES: dict[type[Message], tuple[dict[str, Any], dict[str, Any]]] = {
    RunStart: ({"seed": 0, "dwells": 1}, {"scenario": SKY, "seed": 2**63 - 1, "dwells": LAST, "rate_hz": 0.001}),
    Checkpoint: ({"k": 0, "t": 0}, FULL),
    EmulatorCheckpoint: (
        {"k": 0, "t": 0, "world": None},
        {**FULL, "world": SKY["world"], "world_seed": 2**32, "newest_k": LAST, "newest_t": LAST, "due_k": LAST},
    ),
    Command: ({"by": "x", "action": Resume()}, {"by": "~" * 100, "action": ACTIONS[1], "at": LAST}),
    ScanRecall: ({"k": 0, "targets": [0]}, {"k": LAST, "targets": EDGES}),
    Handover: ({"targets": [0]}, {"targets": EDGES, "taken": True}),
    WaveformRecall: ({"k": 0}, {"k": LAST}),
    NoPlans: (
        {"process": "p", "reason": "?"},
        {"process": LONGEST + "@0-15", "reason": "\u03bb \u2265 0.5: " + "\u00b2" * 380, "late": True},
    ),
    NoWaveforms: ({"process": "a", "reason": "?"}, {"reason": "x" * 400}),
    History: (
        {"k": 0, "payloads": []},
        {"k": LAST, "payloads": [encode(sample(Scan, k=k)) for k in range(20)], "epoch": 1},
    ),
    Scan: (
        {
            **dict.fromkeys(("statistic", "sigma_hat", "signature_power"), EMPTY),
            "bins": NO_BINS,
            "alpha_hat": EMPTY.astype(np.complex64),
            "beams": np.empty((0, 1), np.int32),
            "unmeasured": np.array([0.0]),
        },
        {
            **_looks(100, 10),
            "unmeasured": np.array([-0.3, 0.3]),
            "lost_km": np.array([10.0, 10.03]),
            "fault": "\u00b5s " * 50,
            "waveform_k": -1,
            "skipped": LAST,
            "settings": [ACTIONS[6]],
            "utc_s": 1.7e9 + 0.123456,
            "front_end": "receiver.py:Receiver#0123456789abcdef",
        },
    ),
    Truth: (
        {"states": np.empty((0, 4)), "bins": NO_BINS, "snr_db": EMPTY, "heights_km": EMPTY, "waveform_k": -1},
        {
            "states": _rows(50, 90.0, 0.3, 60.0, -0.2),
            "bins": np.arange(50, dtype=np.int32) * 80,
            "snr_db": _rows(50, -20.0)[:, 0],
            "heights_km": np.linspace(0.0, 12.0, 50),
        },
    ),
    Plan: (
        {
            "status": "searching",
            "bins": NO_BINS,
            "chances": EMPTY,
            "best_bin": -1,
            "range_km": 0.0,
            "estimate": np.zeros(4),
        },
        {
            "k": LAST,
            "target": LAST,
            "bins": np.array([0, 128, 4096], np.int32),
            "chances": np.array([0.0, 1.0, 1.0 / 3.0]),
            "nus": np.array([-0.5, 0.0, 5e-324]),
            "gate": np.array([0.0, 1e9]),
            "covariance": np.diag([1e-60, 2.0, 1e18, 0.1]),
            "existence": 1.0,
            "confirmed": True,
            "in_doubt": False,
            "modes": np.array([0.1, 0.2, 0.7]),
            "plane_estimate": np.array([1e9, -1e9, -0.0, 0.1]),
            "plane_covariance": np.eye(4),
            "n_sim": 65_536,
            "reach": 4096,
            "unseen": [*range(63), LAST],
        },
    ),
    Waveform: (
        {
            "tracking": False,
            "isotropic": 1.0,
            "factor": np.zeros((2, 0), np.complex64),
            "beams": np.empty((0, 1), np.int32),
            "shares": np.empty((0, 1)),
            "status": "acquisition",
            "late": NO_BINS,
        },
        {
            "factor": (_rows(32, *range(1, 17)) * (1.0 - 0.5j)).astype(np.complex64),
            "beams": np.arange(20, dtype=np.int32).reshape(10, 2),
            "shares": np.abs(_rows(10, 0.1, 0.05)),
            "late": np.arange(10, dtype=np.int32) - 1,
            "nus": _rows(10, 0.5, -0.25),
            "gates": np.array([[0.0, 0.0]] * 10),
            "roster": _roster(10),
            "orders": np.array(EDGES, np.int32),
            "settings": [Setting(key="strategy", value="uniform"), ACTIONS[6]],
            "begins_none": True,
        },
    ),
    Snapshot: (
        {
            "belief": np.zeros((1, 4)),
            "remembered": np.empty((0, 4)),
            "looked": np.empty((0, 0)),
            "hit_bin": -1,
            "sigma_hat": 0.0,
            "attempts": 0,
        },
        {
            "belief": _rows(300, 60.0, 0.3, 50.0, 0.2),
            "remembered": _rows(300, 61.0, 0.3, 51.0, 0.2),
            "looked": _rows(5, *range(1, 33)),
            "level": 1e179,
            "unseen": [0],
            "log_evidence": -1e-300,
        },
    ),
    RunCancel: ({}, {"reason": "x" * 500}),
    RunEnd: ({"k": 0, "t": 0}, {"k": LAST, "t": LAST, "status": "failed", "reason": "y" * 500}),
    Opening: ({"dwells": 1, "rate_hz": 0.0}, {"radar": SKY["radar"], "dwells": LAST, "rate_hz": 1000.0}),
    Hello: (
        {"incarnation": "x", "n_tx": 1, "n_rx": 1},
        {"n_tx": 4096, "n_rx": 4096, "hands_over": "data", "max_rate_hz": 1e3, "clock": "utc", "site": "~" * 100},
    ),
    Transmit: (
        {
            **dict.fromkeys(("bins", "first_cells", "n_cells", "merged", "range_cells"), NO_BINS),
            "nus": EMPTY,
            "limits": EMPTY,
            "gates": np.empty((0, 2)),
            "beam_nus": np.empty((0, 1)),
            "k": 0,
            "t": 0,
            "factor": np.zeros((2, 0), np.complex64),
            "beams": np.empty((0, 1), np.int32),
        },
        {
            "k": LAST,
            "t": LAST,
            "factor": (_rows(32, *range(1, 17)) * (1.0 - 0.5j)).astype(np.complex64),
            "range_cells": np.arange(390, dtype=np.int32),
        },
    ),
    Received: (
        {
            **dict.fromkeys(("bins", "statistic", "alpha_hat", "sigma_hat", "signature_power")),
            "fault": "dark",
            "ended": True,
        },
        {
            **{name: value for name, value in _looks(25, 10).items() if name in Received.model_fields},
            "k": LAST,
            "lost_km": np.array([10.0, 10.03]),
            "range_cells": np.arange(390, dtype=np.int32),
            "utc_s": 1.7e9 + 0.123456,
        },
    ),
}


def vectors() -> Iterator[tuple[str, Message]]:
    """Name and message of each."""
    for kind in KINDS:
        changes = CHANGES.get(kind, ({}, {}))
        for size, run, changed in zip(SIZES, ("r", "paper-0f", LONGEST), (changes[0], {}, changes[1]), strict=True):
            yield f"{name_of(kind)}.{size}", sample(kind, run=run, **changed)


def as_json(message: Message) -> dict[str, Any]:
    """Envelope and content of a message as JSON has them; fields that are none are left out."""
    fields = type(message).model_fields
    sent = {name: value for name, value in vars(message).items() if fields[name].is_required() or value is not None}
    return {"v": SCHEMA, "topic": name_of(type(message)), "body": _plain(sent)}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        parts = value.view(np.float32) if value.dtype.kind == "c" and value.size else value.real
        name = {"i4": "i4", "f8": "f8", "c8": "c8"}[value.dtype.str[1:]]
        return {"dtype": name, "shape": list(value.shape), "values": parts.ravel().tolist()}
    if isinstance(value, Compared):
        return {name: _plain(part) for name, part in vars(value).items()}
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if isinstance(value, bytes):
        return {"base64": base64.b64encode(value).decode()}
    return str(value) if isinstance(value, str) else value


def lines() -> str:
    """The file of vectors: a line each."""
    return "".join(
        json.dumps({"name": name, "bytes": base64.b64encode(encode(message)).decode(), "json": as_json(message)}) + "\n"
        for name, message in vectors()
    )


def stored() -> list[dict[str, Any]]:
    """What the file has."""
    return [json.loads(line) for line in FILE.read_text(encoding="utf-8").splitlines()]
