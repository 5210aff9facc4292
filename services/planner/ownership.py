"""Which worker holds which track: rendezvous hashing with a bounded load, among those that may plan for it."""

import hashlib
from collections.abc import Sequence

from cogradar.shared.protocol.slots import N_SLOT, may_plan, slots_in, slots_of


def capacity(worker: str, n_target: int, workers: Sequence[str]) -> int:
    """Most tracks of one run that a worker holds: its share of those that it may plan for, rounded up, and one more.

    It shares them with all workers that may plan for some of them. Others, however many, do not matter.
    """
    slots = [slot for slot in slots_in(slots_of(worker)) if slot < n_target]
    n_able = sum(len(range(slot, n_target, N_SLOT)) for slot in slots)
    n_worker = sum(not set(slots).isdisjoint(slots_in(slots_of(other))) for other in workers)
    return -(-n_able // max(n_worker, 1)) + 1


def owners(run: str, n_target: int, workers: Sequence[str]) -> list[str]:
    """Worker of each track, the same in each process; "" where no worker may plan for a track.

    Each track prefers the workers in the order of their hashes with it, and each worker the tracks. A worker that is
    asked by more than its capacity keeps the best (deferred acceptance: the outcome depends on no order). When a worker
    leaves, its tracks move, and few others: those that the bound had kept from a worker that now may take them, or now
    keeps from one (docs/adr/0007-bounded-ownership.md). A track whose workers are all full, as few may plan for it,
    goes to the first of them.
    """
    most = {worker: capacity(worker, n_target, workers) for worker in workers}
    wishes = [_preferences(run, m, workers) for m in range(n_target)]
    held: dict[str, list[tuple[bytes, int]]] = {worker: [] for worker in workers}
    free, found = list(range(n_target)), [""] * n_target
    asked = [0] * n_target
    while free:
        m = free.pop()
        if asked[m] == len(wishes[m]):
            found[m] = wishes[m][0][1] if wishes[m] else ""
            continue
        score, worker = wishes[m][asked[m]]
        asked[m] += 1
        held[worker].append((score, m))
        if len(held[worker]) > most[worker]:
            least = min(held[worker])
            held[worker].remove(least)
            free.append(least[1])
    for worker, tracks in held.items():
        for _, m in tracks:
            found[m] = worker
    return found


def _preferences(run: str, target: int, workers: Sequence[str]) -> list[tuple[bytes, str]]:
    """(score, worker) of those that may plan for a track, the highest first."""
    able = [worker for worker in workers if may_plan(worker, target)]
    scored = [(hashlib.blake2b(f"{run}/{target}/{w}".encode(), digest_size=16).digest(), w) for w in able]
    return sorted(scored, reverse=True)


def owner_of(run: str, track: int, workers: Sequence[str]) -> str:
    """Worker of one track of an unknown number, "" if there is none: births and ends move no other track."""
    return next((worker for _, worker in _preferences(run, track, workers)), "")
