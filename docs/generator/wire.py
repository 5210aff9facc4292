"""The wire for programs in other languages: one message byte by byte, limits, rights."""

import base64
import struct
from collections.abc import Iterator

from cogradar.shared.protocol.permissions import HOLDERS, Act, permitted
from cogradar.shared.protocol.topics import TOPICS, Role
from cogradar.shared.wire import codec
from docs.generator.markdown import code, table
from tests.vectors.cases import vectors

EXAMPLE = "scan.usual"
_NUMBERS = {"i4": ("i", 4), "f8": ("d", 8), "c8": ("f", 4)}
_EXT = {0xC7: 1, 0xC8: 2, 0xC9: 4}  # first byte; bytes of the length that follows


def example() -> str:
    """A message of the test vectors in hexadecimal, a line for each part."""
    payload = codec.encode(next(message for name, message in vectors() if name == EXAMPLE))
    lines = [
        f"{'  ' * depth + part.hex(' '):<52} {meaning}".rstrip() for depth, part, meaning in _Reader(payload).parts()
    ]
    return (
        "\n".join(["```text", *lines, "```", "", f"The same message in Base64: `{base64.b64encode(payload).decode()}`"])
        + "\n"
    )


def limits() -> str:
    """What a message may have at most."""
    rows = [
        ("bytes of a sample", codec.MAX_BYTES),
        ("messages in a lot", codec.MAX_LOT),
        ("entries of a map", codec.MAX_KEYS),
        ("arrays", codec.MAX_ARRAYS),
        ("maps", codec.MAX_MAPS),
        ("lists", codec.MAX_LISTS),
        ("items of all lists", codec.MAX_ITEMS),
    ]
    return table(("of one message, at most", ""), [(name, f"{most:,}".replace(",", " ")) for name, most in rows])


def rights() -> str:
    """What a holder of a certificate may do."""
    rows = []
    for holder in HOLDERS:
        acts = permitted(holder)
        if holder == Role.ROUTER:
            continue
        names = {topic.pattern("*"): topic.name for topic in TOPICS}
        rows.append(
            (
                f"**{holder}**",
                *(", ".join(names.get(key, code(key)) for key in acts.get(act, ())) for act in (Act.SEND, Act.READ)),
                *(
                    ", ".join(dict.fromkeys(code(key.split("/")[2]) for key in acts.get(act, ())))
                    for act in (Act.ASK, Act.ANSWER)
                ),
            )
        )
    return table(("certificate", "sends", "reads", "asks", "answers"), rows)


class _Reader:
    """Parts of a payload, in order: how deep each is, its bytes, what they mean."""

    def __init__(self, payload: bytes) -> None:
        self._payload, self._at = payload, 0

    def parts(self, depth: int = 0) -> Iterator[tuple[int, bytes, str]]:
        """The next value and all in it. Raises ValueError for a kind that the example has not."""
        first = self._payload[self._at]
        if first < 0x80:
            yield depth, self._take(1), str(first)
        elif first < 0xA0:
            yield depth, self._take(1), f"{'map' if first < 0x90 else 'list'} of {first & 0x0F}"
            for _ in range((first & 0x0F) * (2 if first < 0x90 else 1)):
                yield from self.parts(depth + 1)
        elif first < 0xC0:
            text = self._take(1 + (first & 0x1F))
            yield depth, text, f'"{text[1:].decode()}"'
        elif first in _EXT:
            head = self._take(1 + _EXT[first] + 1)
            n = int.from_bytes(head[1:-1], "big")
            yield depth, head, f"extension value of {n} bytes, type {head[-1]}: an array"
            yield from self._array(depth + 1)
        else:
            raise ValueError(f"{first:#x}")

    def _array(self, depth: int) -> Iterator[tuple[int, bytes, str]]:
        dtype, n_axis = self._take(2), self._take(1)
        yield depth, dtype, f"{dtype.decode()}: the kind of its elements"
        yield depth, n_axis, f"{n_axis[0]} axes" if n_axis[0] != 1 else "1 axis"
        n = 1
        for _ in range(n_axis[0]):
            length = self._take(4)
            yield depth, length, f"length {int.from_bytes(length, 'little')}"
            n *= int.from_bytes(length, "little")
        element, size = _NUMBERS[dtype.decode()]
        for i in range(n * (2 if dtype == b"c8" else 1)):
            part = self._take(size)
            name = ("", "") if dtype != b"c8" else (" real", " imaginary")
            yield depth, part, f"{struct.unpack('<' + element, part)[0]}{name[i % 2]}"

    def _take(self, n: int) -> bytes:
        self._at += n
        return self._payload[self._at - n : self._at]
