"""The digest of a run: what it depends on, and what it does not."""

import hashlib
from collections.abc import Iterable

import numpy as np
import pytest

from cogradar.shared.protocol.messages import Message, Plan, Scan, Waveform
from cogradar.shared.wire.codec import encode, renamed
from cogradar.shared.wire.digest import DIGESTED, Digest
from tests.samples import FIELDS, RUN, plan, sample

SAID = [sample(Scan), sample(Plan), sample(Waveform)]


def digest(messages: Iterable[Message], run: str = RUN) -> str:
    found = Digest(run)
    for message in messages:
        found.add(encode(message))
    return found.hexdigest()


def test_digest_is_sha256_of_the_encoded_messages_without_the_run() -> None:
    joined = b"".join(encode(message).replace(b"\xa5run-1", b"\xa1-") for message in SAID)  # as MessagePack has strings
    assert digest(SAID) == hashlib.sha256(joined).hexdigest()
    assert digest([]) == hashlib.sha256(b"").hexdigest()
    assert set(DIGESTED) == {"scan", "plan", "waveform"}


def test_repeated_runs_compare_whatever_their_name() -> None:
    assert digest((sample(kind, run="other") for kind in (Scan, Plan, Waveform)), "other") == digest(SAID)


@pytest.mark.parametrize("name", ["9", "run", "a" * 31, "b" * 32, "c" * 64])
@pytest.mark.parametrize("kind", FIELDS, ids=lambda kind: kind.__name__)
def test_a_message_under_another_name_is_encoded_as_if_it_had_been_said_so(kind: type[Message], name: str) -> None:
    assert renamed(encode(sample(kind)), RUN, name) == encode(sample(kind, run=name))
    assert renamed(encode(sample(kind, run=name)), name, RUN) == encode(sample(kind))


def test_a_message_of_another_run_is_no_part_of_a_digest() -> None:
    with pytest.raises(ValueError, match="no message of run-1"):
        Digest(RUN).add(encode(sample(Scan, run="run-10")))


@pytest.mark.parametrize(
    "changed",
    [
        sample(Scan, statistic=np.nextafter(FIELDS[Scan]["statistic"], np.inf)),  # one unit in the last place
        sample(Scan, k=4),
        plan(estimate=np.array([1.0, 1.0, 1.0, 1.0 + 2.0**-52])),
        plan(detected=True),
        sample(Waveform, status="inaccurate"),
    ],
    ids=lambda message: type(message).__name__,
)
def test_any_bit_counts(changed: Message) -> None:
    assert digest([changed if type(m) is type(changed) else m for m in SAID]) != digest(SAID)


def test_order_and_number_count() -> None:
    assert len({digest(SAID), digest(SAID[::-1]), digest(SAID[:2]), digest([*SAID, SAID[0]])}) == 4
