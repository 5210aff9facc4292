"""The digest of a run: what it depends on, and what it does not."""

import hashlib

import numpy as np
import pytest

from shared.messages import Message, Plan, Scan, Waveform
from shared.wire.codec import decode, encode
from shared.wire.trace import DIGESTED, digest
from tests.shared.samples import FIELDS, plan, sample

RUN = [sample(Scan), sample(Plan), sample(Waveform)]


def test_digest_is_sha256_of_the_encoded_messages_without_the_run() -> None:
    joined = b"".join(encode(message).replace(b"\xa5run-1", b"\xa1-") for message in RUN)  # as MessagePack has strings
    assert digest(RUN) == hashlib.sha256(joined).hexdigest()
    assert digest([]) == hashlib.sha256(b"").hexdigest()
    assert set(DIGESTED) == {"scan", "plan", "waveform"}


def test_repeated_runs_compare_whatever_their_name_and_however_they_travelled() -> None:
    assert digest(sample(kind, run="other") for kind in (Scan, Plan, Waveform)) == digest(RUN)
    assert digest(decode(encode(message)) for message in RUN) == digest(RUN)


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
    assert digest([changed if type(m) is type(changed) else m for m in RUN]) != digest(RUN)


def test_order_and_number_count() -> None:
    assert len({digest(RUN), digest(RUN[::-1]), digest(RUN[:2]), digest([*RUN, RUN[0]])}) == 4
