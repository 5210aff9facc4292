"""Keyed random numbers."""

import hashlib
import itertools
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogradar.shared.numerics.seeds import Purpose, generator

KEYS = st.tuples(
    st.integers(0, 2**64 - 1), st.sampled_from(Purpose), st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**63 - 1)
)


@given(key=KEYS)
def test_equal_keys_give_equal_streams(key: tuple[int, Purpose, int, int]) -> None:
    np.testing.assert_array_equal(generator(*key).random(5), generator(*key).random(5))


@given(one=KEYS, other=KEYS)
def test_different_keys_give_different_streams(
    one: tuple[int, Purpose, int, int], other: tuple[int, Purpose, int, int]
) -> None:
    assert (one == other) == (generator(*one).random() == generator(*other).random())


def test_every_part_of_the_key_counts() -> None:
    keys = list(itertools.product((0, 1), Purpose, (0, 1), (0, 1)))
    first = {float(generator(*key).random()) for key in keys}
    assert len(first) == len(keys)


# generator(1, purpose, 2, 3).integers(2**63, size=2) when the purpose was defined.
GOLDEN = {
    Purpose.MOTION: [3787525920716991768, 8313711217584274167],
    Purpose.DISTURBANCE: [5751676682438635972, 3684090402175954396],
    Purpose.PHASE: [3063748721435149432, 3444533056910627328],
    Purpose.INITIATION: [3760009600284446775, 680093181136583133],
    Purpose.BELIEF: [1423273599460149244, 4881100081701900592],
    Purpose.SEARCH: [7202555972808456383, 4035225689459203118],
    Purpose.BOOTSTRAP: [8852798784280086305, 3236622830518632317],
    Purpose.FAULT: [3997503312366969820, 2281815039291899276],
    Purpose.SKY: [210027931675299574, 9129147925311727688],
    Purpose.EMPTY: [367586273232593281, 3339033062847362406],
    Purpose.RCS: [53533720886836690, 8738047927240312609],
    Purpose.JAMMER: [7709903070497534283, 7393202921855568459],
    Purpose.ELEMENTS: [5827903280362956432, 7005764346198992286],
    Purpose.CLUTTER: [5266480162196280748, 7616145335497552871],
}


def test_the_stream_of_every_purpose_is_fixed() -> None:
    """If one changes, no stored run can be replayed; a new purpose gets its numbers here."""
    assert {purpose: generator(1, purpose, 2, 3).integers(2**63, size=2).tolist() for purpose in Purpose} == GOLDEN


def test_the_state_is_that_of_sfc64_with_the_hash_as_its_three_words() -> None:
    """Restated: state (a, b, c) from BLAKE2b of the key, counter 1, twelve rounds discarded."""
    mask = 2**64 - 1
    key = struct.pack("<Qqq", 7, 2, 3) + b"search"
    a, b, c = struct.unpack("<QQQ", hashlib.blake2b(key, digest_size=24).digest())
    outputs = []
    for counter in range(1, 16):
        outputs.append((a + b + counter) & mask)
        a, b, c = b ^ (b >> 11), (c + (c << 3)) & mask, ((c << 24 | c >> 40) + outputs[-1]) & mask
    drawn = generator(7, Purpose.SEARCH, 2, 3).integers(2**64, size=3, dtype=np.uint64)
    assert drawn.tolist() == outputs[12:]


def test_neighbouring_keys_are_uncorrelated() -> None:
    draws = np.array([generator(0, Purpose.SEARCH, 0, k).standard_normal(1000) for k in range(50)])
    correlation = np.corrcoef(draws)[np.triu_indices(50, 1)]
    assert np.max(np.abs(correlation)) < 6.0 / np.sqrt(1000)  # 6 sigma for the largest of 1225: 2e-6


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_a_seed_out_of_range_is_refused(seed: int) -> None:
    with pytest.raises(struct.error):
        generator(seed, Purpose.MOTION, 0, 0)
