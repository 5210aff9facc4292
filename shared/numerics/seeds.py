"""Keyed random numbers: a generator is a function of what it is for, never of what was drawn before."""

import hashlib
import struct
from enum import StrEnum

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import DTypeLike, NDArray


class Purpose(StrEnum):
    """What the numbers are for; part of the key, so no two uses ever share a stream."""

    MOTION = "motion"  # index: target, k: tracking dwell
    DISTURBANCE = "disturbance"  # index: bin, and which range cell, k: dwell
    EMPTY = "empty"  # range cells of a look; index: bits of its direction, k: dwell
    PHASE = "phase"  # index: target, k: dwell
    JAMMER = "jammer"  # index: jammer, and which range cell, k: dwell
    CLUTTER = "clutter"  # index: range cell
    ELEMENTS = "elements"  # errors of antennas; index: 0 those that send, 1 those that receive
    RCS = "rcs"  # index: target, k: dwell
    INITIATION = "initiation"  # index: target, k: dwell
    BELIEF = "belief"  # index: target, k: dwell
    SEARCH = "search"  # index: target, k: dwell
    BOOTSTRAP = "bootstrap"
    FAULT = "fault"  # k: number of the process killed
    SKY = "sky"  # of a scenario that is made; index: aircraft


class _Words(ISeedSequence):
    """The three words of SFC64's state as they are.

    NumPy's own SeedSequence would mix them once more, for keys of poor entropy; a hash has no need of it, and a dwell
    that tests every cell makes a hundred generators.
    """

    def __init__(self, digest: bytes) -> None:
        self._words = np.frombuffer(digest, dtype="<u8")

    def generate_state(self, n_words: int, dtype: DTypeLike = np.uint64) -> NDArray[np.uint64]:
        """The words; the bit generator asks for three of 64 bits."""
        if n_words != self._words.size or np.dtype(dtype) != np.uint64:
            raise ValueError(f"{n_words} words of {np.dtype(dtype)} asked for, there are {self._words.size} of 64 bits")
        return self._words


def radar_seed(seed: int) -> int:
    """Seed of the radar's own random numbers: a one-way function of the run's seed, which the world draws from.

    Planners are told this one. They cannot draw the world's motion and disturbance from it.
    """
    digest = hashlib.blake2b(struct.pack("<Q", seed), digest_size=8, person=b"cogradar-radar").digest()
    return int.from_bytes(digest, "little") >> 1


def generator(seed: int, purpose: Purpose, index: int, k: int) -> np.random.Generator:
    """Generator of (seed, purpose, target or bin, dwell); equal keys give equal streams, on every process.

    The key is hashed to the 192 bits of SFC64's state (its counter starts at 1), so that two of n keys share a stream
    with a probability of about n^2 / 2^193: never. The strategy is not part of the key: all strategies of a seed see
    the same targets and the same disturbance.
    """
    key = struct.pack("<Qqq", seed, index, k) + purpose.encode()
    words = _Words(hashlib.blake2b(key, digest_size=24).digest())
    return np.random.Generator(np.random.SFC64(words))  # type: ignore[arg-type] # NumPy's stubs omit ISeedSequence
