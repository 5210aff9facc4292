"""What must hold of all runs, whatever the faults."""

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.emulator.front_end import Transmission
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import Checkpoint, Message, RunStart, Waveform
from cogradar.shared.protocol.orders import Order, in_force, is_paused, power_share

TOLERANCE = 1e-5  # of the power; waveforms are complex64 on the wire
SHARED_S = 10.0  # after the last fault, and after the first plan of a track: planners have shared it, late plans or not
_OF_RUN = "SELECT status, reason, digest, acknowledged_k, acknowledged_t, acquisition_scans, conflicts FROM run"


class Violated(AssertionError):
    """What must hold does not; the text says what."""


class Dwell(NamedTuple):
    """One that was radiated."""

    run: str
    at_s: float
    k: int
    t: int
    isotropic: float
    factor: bytes
    orders: Sequence[Order]  # that the emulator had been told
    is_measured: bool  # its receiver was not out

    @classmethod
    def of(
        cls, run: str, at_s: float, at: tuple[int, int], waveform: Transmission, told: "Told", *, is_measured: bool
    ) -> "Dwell":
        """A transmission of dwell k at clock t, `at`."""
        factor = waveform.factor.astype(np.complex64).tobytes()
        return cls(run, at_s, *at, waveform.isotropic, factor, told.orders.get(run, ()), is_measured)


class Told:
    """What any process was told to be acknowledged: no death of a recorder takes it back."""

    def __init__(self) -> None:
        self._k: dict[str, int] = {}  # dwells, by run
        self.orders: dict[str, Sequence[Order]] = {}  # by run, that an emulator was told,
        self._ordered: dict[str, tuple[int, int]] = {}  # ... at which dwell, and which was the last
        self.is_restored = False  # a journal that was restored lacks some

    def hear(self, checkpoint: Checkpoint, journal: Journal | None) -> None:
        """A process heeds a checkpoint. Raises Violated if the journal does not have what it says."""
        if checkpoint.k > self._k.get(checkpoint.run, 0):
            self._k[checkpoint.run] = checkpoint.k
            self.check(journal)

    def hear_orders(self, checkpoint: Checkpoint) -> None:
        """An emulator heeds a checkpoint; one that was overtaken takes no order back."""
        at = checkpoint.k, max((order.n for order in checkpoint.orders), default=-1)
        if at >= self._ordered.get(checkpoint.run, at):
            self._ordered[checkpoint.run], self.orders[checkpoint.run] = at, checkpoint.orders

    def check_ahead(self, run: str, k: int, most: int) -> None:
        """Raises Violated if dwell k is radiated too far ahead of what the journal is said to have."""
        if (ahead := k - self._k.get(run, 0)) >= most:
            raise Violated(f"{run}: dwell {k} is radiated, {ahead} ahead of the journal, at most {most - 1}")

    def check(self, journal: Journal | None) -> None:
        """Raises Violated if a journal lacks a dwell. None: its recorder is dead, and its next one is looked at."""
        if journal is None or self.is_restored:
            return
        for run, k in self._k.items():
            rows = journal.rows("SELECT acknowledged_k, kept_k, rate_hz FROM run WHERE run = ?", [run])
            acknowledged, kept_k, rate_hz = tuple(rows[0]) if rows else (0, 0, 0.0)
            scans = "SELECT COUNT(*) FROM message WHERE run = ? AND topic = 'scan' AND k < ?"
            (found,) = journal.rows(scans, [run, k])
            is_whole = found[0] >= k - kept_k or pacing_at(rate_hz).loses_dwells
            if acknowledged < k or not is_whole:
                there = f"acknowledges {acknowledged} and has {found[0]} scans of them"
                raise Violated(f"{run}: {k} dwells were said to be acknowledged, the journal {there}")


def check_power(
    starts: Sequence[RunStart], radiated: Iterable[Dwell], given: Mapping[str, Sequence[Order | None]], since_s: float
) -> None:
    """No more is radiated than the array has, or than an order allows. Raises Violated.

    given   : what became of the commands of each run; in real time the radar may be told of one too late for its dwell
    since_s : when an older journal was put in place last; in lockstep orders of dwells before may be lost
    """
    loses = {start.run: pacing_at(start.rate_hz).loses_dwells for start in starts}
    limits = {start.run: float(start.scenario["radar"]["array"]["power"]) for start in starts}
    orders = {run: [order for order in commands if order is not None] for run, commands in given.items()}
    for dwell in radiated:
        power = dwell.isotropic + float(np.sum(np.abs(np.frombuffer(dwell.factor, np.complex64)) ** 2))
        followed = orders[dwell.run] if dwell.at_s >= since_s else []
        there = in_force(dwell.orders if loses[dwell.run] else followed, dwell.k)
        limit = 0.0 if is_paused(there) else limits[dwell.run] * power_share(there)
        if not power <= limit * (1.0 + TOLERANCE):
            raise Violated(f"{dwell.run}: dwell {dwell.k} with power {power:g}, at most {limit:g}")


def check_waveforms(starts: Sequence[RunStart], radiated: Iterable[Dwell], said: Iterable[Message]) -> None:
    """What was radiated in a run was made for it, or is what any run begins with, or so much of it as orders let be.

    Raises Violated.
    """
    power = {start.run: float(start.scenario["radar"]["array"]["power"]) for start in starts}
    made = {(run, isotropic, b"") for run, isotropic in power.items()}
    made |= {(one.run, one.isotropic, one.factor.tobytes()) for one in said if isinstance(one, Waveform)}
    for dwell in radiated:
        most = power[dwell.run] * power_share(in_force(dwell.orders, dwell.k))
        sent = dwell.run, dwell.isotropic, dwell.factor
        if sent not in made and sent not in {_limited(one, most) for one in made if one[0] == dwell.run}:
            raise Violated(f"{dwell.run}: dwell {dwell.k} was radiated with a waveform that was not made for it")


def _limited(made: tuple[str, float, bytes], most: float) -> tuple[str, float, bytes]:
    """What is radiated of a waveform if orders let be so much."""
    run, isotropic, packed = made
    factor = np.frombuffer(packed, np.complex64).astype(np.complex128)
    power = isotropic + float(np.sum(np.abs(factor) ** 2))
    share = min(most / power, 1.0) if power else 1.0  # of a pause there is none
    return run, share * isotropic, (np.sqrt(share) * factor).astype(np.complex64).tobytes()


def check_planned_once(planned: Mapping[tuple[str, int, int], Mapping[str, float]], quiet_s: float) -> None:
    """Once planners have shared the tracks, each is planned by one of them. Raises Violated.

    Not where plans were overdue, or a planner hangs for good: others have its tracks, and one that missed that does not
    know for how long.

    planned : by run, dwell and track which planner sent a plan, and when first
    """
    since_s: dict[tuple[str, int], float] = {}  # a track that begins is shared, too
    for (run, k, target), at_s in sorted(planned.items()):
        first_s = min(at_s.values())
        settled_s = max(quiet_s, since_s.setdefault((run, target), first_s)) + SHARED_S
        if len(at_s) > 1 and first_s >= settled_s:
            raise Violated(f"{run}: dwell {k} of track {target + 1} is planned by {' and '.join(sorted(at_s))}")


def fingerprint(journal: Journal, run: str) -> tuple[object, ...]:
    """All that scores are made of: how the run ended, and every message, byte for byte."""
    (row,) = journal.rows(f"{_OF_RUN} WHERE run = ?", [run])
    content = hashlib.blake2b(digest_size=16)
    query = "SELECT k, topic, item, payload FROM message WHERE run = ? ORDER BY k, topic, item"
    for k, topic, item, payload in journal.rows(query, [run]):
        content.update(f"{k} {topic} {item} {len(payload)} ".encode() + payload)
    return (*row, content.hexdigest())


def check_journal(journal: Journal, starts: Sequence[RunStart], said: Collection[bytes]) -> None:
    """All runs came to their end, and what is in the journal was sent. Raises Violated."""
    for start in starts:
        sent = "SELECT k, topic, item, payload FROM message WHERE run = ?"
        for k, topic, item, payload in journal.rows(sent, [start.run]):
            if payload not in said:
                raise Violated(f"{start.run}: {topic} {item} of dwell {k} was never sent")
        if journal.rows("SELECT 1 FROM snapshot WHERE run = ?", [start.run]):
            raise Violated(f"{start.run}: there are snapshots, although it is over")
        (row,) = journal.read(f"{_OF_RUN} WHERE run = ?", [start.run])
        # In real time the clock goes on while the emulator is away; of dwells that never were the recorder is not told.
        may_skip = pacing_at(start.rate_hz).loses_dwells
        is_all = row["acknowledged_t"] == start.dwells or (may_skip and row["acknowledged_t"] < start.dwells)
        if journal.rows("SELECT 1 FROM command WHERE run = ? AND k IS NOT NULL AND action LIKE '%end%'", [start.run]):
            continue
        if row["status"] != "complete" or not is_all:
            ended = f"{row['status']} at t = {row['acknowledged_t']} of {start.dwells} {row['reason']}"
            raise Violated(f"{start.run}: {ended}")
