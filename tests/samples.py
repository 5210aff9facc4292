"""One valid message of every topic, for tests that only need some message."""

import hashlib
from collections.abc import Iterable
from copy import deepcopy
from typing import Any

import numpy as np

from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import (
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
from cogradar.shared.protocol.orders import PowerLimit
from cogradar.shared.protocol.recovery import (
    Handover,
    History,
    NoPlans,
    NoWaveforms,
    ScanRecall,
    Snapshot,
    WaveformRecall,
)
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import encode

RUN = "run-1"
SMOKE = load("smoke").model_dump()
ROW = np.array([1.0, 2.0, 3.0])
BINS = np.array([2, 5, 9], np.int32)
BEAMS = np.array([[5], [9]], np.int32)


def asked(*bins: int) -> dict[str, Any]:
    """Fields of a plan that asks for these bins."""
    chances = np.full(len(bins), 1.0 / len(bins))
    return {"bins": np.array(bins, np.int32), "chances": chances, "best_bin": bins[0]}


FIELDS: dict[type[Message], dict[str, Any]] = {
    RunStart: {"scenario": SMOKE, "strategy": Strategy.UNIFORM, "seed": 7, "dwells": 12},
    Checkpoint: {"radar": SMOKE["radar"], "strategy": Strategy.UNIFORM, "seed": 7, "dwells": 12, "k": 3, "t": 1},
    EmulatorCheckpoint: {
        "radar": SMOKE["radar"],
        "world": SMOKE["world"],
        "strategy": Strategy.UNIFORM,
        "seed": 7,
        "world_seed": 5,
        "dwells": 12,
        "k": 3,
        "t": 1,
    },
    RunCancel: {},
    Command: {"id": "0f" * 16, "by": "commander.me", "action": PowerLimit(share=0.5)},
    ScanRecall: {"k": 3, "targets": [0, 2], "planner": "p1"},
    Handover: {"planner": "p1", "k": 3, "targets": [1], "taken": False},
    WaveformRecall: {"k": 3},
    NoPlans: {"process": "p1", "reason": "ahead.py: not here", "ends": False},
    NoWaveforms: {"process": "a1", "reason": "ahead.py: raised", "ends": True},
    History: {"to": "p1", "topic": "scan", "k": 3, "payloads": [b"one", b"two"]},
    Scan: {
        "k": 3,
        "t": 1,
        "bins": BINS,
        "statistic": ROW,
        "alpha_hat": ROW.astype(np.complex64),
        "sigma_hat": ROW,
        "signature_power": ROW,
        "beams": BEAMS,
    },
    Truth: {
        "k": 3,
        "t": 1,
        "states": np.ones((2, 4)),
        "bins": BEAMS[:, 0],
        "snr_db": np.array([-12.0, -11.3]),
        "heights_km": np.array([0.0, 11.0]),
        "waveform_k": 2,
    },
    Plan: {"k": 3, "t": 1, "target": 1, "status": "tracking", **asked(5), "range_km": 63.2, "estimate": np.ones(4)},
    Waveform: {
        "k": 3,
        "tracking": True,
        "isotropic": 0.5,
        "factor": np.ones((16, 2), np.complex64),
        "beams": BEAMS,
        "shares": np.array([[0.25], [0.25]]),
        "status": "optimal",
        "late": np.array([0, 1], np.int32),
    },
    Snapshot: {
        "k": 255,
        "target": 1,
        "belief": np.arange(20.0).reshape(5, 4),
        "detected": False,
        "depleted": True,
        "sigma_hat": 0.1,
        "in_beam": True,
        "level": 0.2,
        "power": 7.5,
        "echo": 0.02,
        "remembered": np.ones((5, 4)),
        "hit_bin": 2,
        "hit_amplitude": 16.5,
        "measured": np.array([0.25, 0.251, 0.001, 50.25]),
        "looked": np.array([[0.0, 0.0, 0.1], [0.0, 0.3, 0.0]]),
        "log_evidence": -2.5,
        "attempts": 1,
        "modes": np.array([0.7, 0.2, 0.1]),
        "existence": 0.99,
        "confirmed": True,
        "in_doubt": False,
    },
    RunEnd: {"k": 3, "t": 1, "status": "complete"},
}
# What the emulator and a front end ask and answer: of no topic.
EXCHANGED: dict[type[Message], dict[str, Any]] = {
    Opening: {"radar": SMOKE["radar"], "dwells": 12, "rate_hz": 10.0},
    Hello: {
        "incarnation": "0f1e2d3c",
        "n_tx": 16,
        "n_rx": 16,
        "hands_over": "looks",
        "max_rate_hz": 20.0,
        "clock": "none",
    },
    Transmit: {
        "k": 3,
        "t": 1,
        "deadline_s": 0.05,
        "isotropic": 0.5,
        "factor": np.ones((16, 2), np.complex64),
        "bins": BINS,
        "nus": np.array([-0.36, -0.16, 0.11]),
        "limits": ROW,
        "first_cells": np.array([80, 80, 0], np.int32),
        "n_cells": np.array([2, 2, 390], np.int32),
        "merged": np.zeros(3, np.int32),
        "range_cells": np.array([80, 81], np.int32),
        "beams": BEAMS,
        "beam_nus": np.array([[-0.16], [0.11]]),
        "gates": np.array([[40.0, 41.0], [0.0, 0.0]]),
    },
    Received: {
        "incarnation": "0f1e2d3c",
        "k": 3,
        "bins": BINS,
        "statistic": ROW,
        "alpha_hat": ROW.astype(np.complex64),
        "sigma_hat": ROW,
        "signature_power": ROW,
    },
}


def sample(kind: type[Message], **changed: Any) -> Message:
    """A valid message with arrays of its own, some fields changed."""
    return kind(**{"run": RUN, **deepcopy((FIELDS | EXCHANGED)[kind]), **changed})


def digest(messages: Iterable[Message]) -> str:
    """Digest of messages of one run or several."""
    total = hashlib.sha256()
    for message in messages:
        total.update(encode(message.model_copy(update={"run": "-"})))
    return total.hexdigest()


def plan(k: int = 3, **changed: Any) -> Plan:
    """A plan of dwell k."""
    message = sample(Plan, **{"k": k, **changed})
    assert isinstance(message, Plan)
    return message
