"""Keyed random numbers: a generator is a function of what it is for, never of what was drawn before."""

import hashlib
import struct
from enum import StrEnum

import numpy as np


class Purpose(StrEnum):
    """What the numbers are for; part of the key, so no two uses ever share a stream."""

    MOTION = "motion"  # index: target, k: tracking dwell
    DISTURBANCE = "disturbance"  # index: bin, k: dwell
    PHASE = "phase"  # index: target, k: dwell
    INITIATION = "initiation"  # index: target, k: dwell
    BELIEF = "belief"  # index: target, k: dwell
    SEARCH = "search"  # index: target, k: dwell
    BOOTSTRAP = "bootstrap"


def generator(seed: int, purpose: Purpose, index: int, k: int) -> np.random.Generator:
    """Generator of (seed, purpose, target or bin, dwell); equal keys give equal streams, on every process.

    The strategy is not part of the key: all strategies of a seed see the same targets and the same disturbance.
    """
    key = struct.pack("<Qqq", seed, index, k) + purpose.encode()
    entropy = int.from_bytes(hashlib.blake2b(key, digest_size=16).digest(), "little")
    return np.random.Generator(np.random.SFC64(entropy))
