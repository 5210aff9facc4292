"""Captures of packets, as tcpdump and Wireshark write them (pcap and pcapng): the UDP datagrams in them.

No library is light and well kept: `scapy` has the GPL and 24 MB. `dpkt` takes all interfaces of a pcapng for the first
one, and had its last release in 2022. libpcap refuses a pcapng with interfaces of different types. Formats: the drafts
draft-ietf-opsawg-pcap and -pcapng, and the list of link types of tcpdump.org.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

from cogradar.services.errors import BadInput

_PCAP = {  # byte order and ticks a second by the first bytes
    b"\xd4\xc3\xb2\xa1": ("<", 10**6),
    b"\xa1\xb2\xc3\xd4": (">", 10**6),
    b"\x4d\x3c\xb2\xa1": ("<", 10**9),
    b"\xa1\xb2\x3c\x4d": (">", 10**9),
}
_SECTION = b"\x0a\x0d\x0d\x0a"  # a block of pcapng, in both byte orders; of others the numbers:
_INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _PACKET = 1, 2, 3, 6
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_RESOLUTION, _OFFSET = 9, 14  # options of an interface
_MOST_BYTES = 1 << 24  # of a packet or block: more is no length
_MOST_S = 2e11  # since 1970: later is no time

_LINKS: dict[int, tuple[int | None, int]] = {  # by link type: where the EtherType is, if anywhere, and what follows it
    1: (12, 14),  # Ethernet
    113: (14, 16),  # Linux cooked capture
    276: (0, 20),  # its second version
    **dict.fromkeys((12, 14, 101, 228, 229), (None, 0)),  # raw IP
    **dict.fromkeys((0, 108), (None, 4)),  # loopback of BSD and macOS
}
_VLAN, _IPV4, _IPV6 = (0x8100, 0x88A8, 0x9100), 0x0800, 0x86DD
_UDP, _FRAGMENT, _EXTENSIONS = 17, 44, (0, 43, 60)  # hop by hop, routing, destination
_DAMAGED, _NO_UDP = "are damaged", "are not UDP over IP"
_IS_FRAGMENT = (
    "are fragments of longer ones, which tshark puts together: tshark -r FILE -o ip.defragment:TRUE -T fields"
    " -e udp.payload | xxd -r -p > FILE.ast"
)
_IN_PART = "were captured in part; tcpdump -s 0 captures them whole"


class _Packet(NamedTuple):
    """A packet as it was captured."""

    time_s: float | None  # since 1970, UTC
    link: int  # type
    data: bytes


class _Interface(NamedTuple):
    """Of a pcapng."""

    link: int
    most: int  # bytes of a packet; 0: no limit
    ticks: int  # a second
    offset_s: int

    def packet(self, high: int, low: int, data: bytes) -> _Packet:
        return _Packet(_time(self.offset_s + ((high << 32) + low) / self.ticks), self.link, data)


class _LeftOut(Exception):
    """A packet has no whole UDP datagram; the text says why, as "they ..."."""


def is_capture(head: bytes) -> bool:
    """Whether a file begins as a pcap or a pcapng."""
    return head[:4] in _PCAP or head[:4] == _SECTION


class Capture:
    """The packets of a capture, and how many of them are left out."""

    def __init__(self, file: Path, stream: IO[bytes]) -> None:
        self._file, self._stream = file, stream
        self._magic = stream.read(4)
        self.form = "pcap" if self._magic in _PCAP else "pcapng"
        self.n = 0  # packets so far
        self.left = Counter[str]()  # packets by reason, "they ..."
        self.is_cut = False  # ends within a packet

    @property
    def reasons(self) -> str:
        """What was left out, in a line."""
        return "; ".join(f"{n} {words}" for words, n in self.left.most_common(5)) or "it is empty"

    def datagrams(self) -> Iterator[tuple[float | None, bytes]]:
        """Time, s since 1970, and payload of each UDP datagram. Raises BadInput where lengths cannot be."""
        try:
            for packet in self._of_pcap() if self.form == "pcap" else self._of_pcapng():
                self.n += 1
                try:
                    datagram = _payload(packet)
                except _LeftOut as reason:
                    self.left[str(reason)] += 1
                else:
                    yield packet.time_s, datagram
        except EOFError:
            self.is_cut = True
        except struct.error:
            raise self._fault() from None

    def _of_pcap(self) -> Iterator[_Packet]:
        order, ticks = _PCAP[self._magic]
        link = struct.unpack(order + "16xI", self._read(20))[0] & 0xFFFF
        while head := self._read(16, may_end=True):
            seconds, part, length, _ = struct.unpack(order + "4I", head)
            if length > _MOST_BYTES:
                raise self._fault()
            yield _Packet(_time(seconds + part / ticks), link, self._read(length))

    def _of_pcapng(self) -> Iterator[_Packet]:
        order, interfaces, kind = "<", list[_Interface](), self._magic
        while kind:
            size, body = self._read(4), b""
            if kind == _SECTION:
                body, interfaces = self._read(4), []
                if body not in _ORDERS:
                    raise self._fault()
                order = _ORDERS[body]
            (length,) = struct.unpack(order + "I", size)
            if length % 4 or not 12 + len(body) <= length <= _MOST_BYTES:
                raise self._fault()
            body += self._read(length - 12 - len(body))
            if self._read(4) != size:
                raise self._fault()
            number = struct.unpack(order + "I", kind)[0]
            if number == _INTERFACE:
                interfaces.append(_interface(order, body))
            elif number in (_OLD_PACKET, _SIMPLE_PACKET, _PACKET):
                yield self._packet(order, number, body, interfaces)
            kind = self._read(4, may_end=True)

    def _packet(self, order: str, number: int, body: bytes, interfaces: list[_Interface]) -> _Packet:
        """The packet of a block."""
        if number == _SIMPLE_PACKET:
            which, high, low, (length,), begin = 0, 0, 0, struct.unpack_from(order + "I", body), 4
        else:
            form = "5I" if number == _PACKET else "HxxIIII"
            (which, high, low, length, _), begin = struct.unpack_from(order + form, body), 20
        if which >= len(interfaces):
            raise self._fault()
        interface = interfaces[which]
        if number == _SIMPLE_PACKET:
            length = min(length, interface.most or length)
        if length > len(body) - begin:
            raise self._fault()
        found = interface.packet(high, low, body[begin : begin + length])
        return found._replace(time_s=None) if number == _SIMPLE_PACKET else found

    def _read(self, n: int, *, may_end: bool = False) -> bytes:
        """So many bytes; none at the end of the file if it may end here. Raises EOFError if there are fewer."""
        data = self._stream.read(n)
        if len(data) < n and (data or not may_end):
            raise EOFError
        return data

    def _fault(self) -> BadInput:
        return BadInput(f"{self._file}: is a damaged capture: after packet {self.n} it has lengths that cannot be")


def _time(time_s: float) -> float | None:
    return time_s if 0.0 <= time_s < _MOST_S else None


def _interface(order: str, body: bytes) -> _Interface:
    link, most = struct.unpack_from(order + "HxxI", body)
    found, begin = _Interface(link, most, 10**6, 0), 8
    while begin + 4 <= len(body):
        option, length = struct.unpack_from(order + "HH", body, begin)
        if option == _RESOLUTION:
            (power,) = struct.unpack_from("B", body, begin + 4)
            found = found._replace(ticks=2 ** (power - 128) if power >= 128 else 10**power)
        elif option == _OFFSET:
            found = found._replace(offset_s=struct.unpack_from(order + "q", body, begin + 4)[0])
        begin += 4 + length + -length % 4
    return found


def _payload(packet: _Packet) -> bytes:
    """The payload of the UDP datagram that a packet has. Raises _LeftOut."""
    if packet.link not in _LINKS:
        raise _LeftOut(f"have link type {packet.link}, must be Ethernet, Linux cooked, raw IP or loopback")
    where, begin = _LINKS[packet.link]
    data = packet.data
    if where is None:
        kind = {4: _IPV4, 6: _IPV6}.get(data[begin] >> 4 if len(data) > begin else 0, 0)
    else:
        kind = _number(data, where)
        while kind in _VLAN:
            kind, begin = _number(data, begin + 2), begin + 4
    if kind not in (_IPV4, _IPV6):
        raise _LeftOut(_NO_UDP)
    udp = _of_ipv4(data[begin:]) if kind == _IPV4 else _of_ipv6(data[begin:])
    length = _number(udp, 4) or len(udp)  # 0: of a jumbogram
    if length < 8:
        raise _LeftOut(_DAMAGED)
    if length > len(udp):
        raise _LeftOut(_IN_PART)
    return udp[8:length]


def _of_ipv4(data: bytes) -> bytes:
    """The UDP datagram, with its header. Raises _LeftOut."""
    if len(data) < 20:
        raise _LeftOut(_IN_PART)
    header, total = 4 * (data[0] & 0x0F), _number(data, 2) or len(data)  # 0: cut up later, by the network card
    if data[9] != _UDP:
        raise _LeftOut(_NO_UDP)
    if _number(data, 6) & 0x3FFF:  # more of them follow, or an offset
        raise _LeftOut(_IS_FRAGMENT)
    if header < 20:
        raise _LeftOut(_DAMAGED)
    return data[header:total]


def _of_ipv6(data: bytes) -> bytes:
    """The UDP datagram, with its header. Raises _LeftOut."""
    if len(data) < 40:
        raise _LeftOut(_IN_PART)
    kind, data = data[6], data[40 : 40 + (_number(data, 4) or len(data))]
    while kind in (*_EXTENSIONS, _FRAGMENT) and len(data) >= 8:
        if kind == _FRAGMENT and _number(data, 2) & 0xFFF9:
            raise _LeftOut(_IS_FRAGMENT)
        size = 8 if kind == _FRAGMENT else 8 * (data[1] + 1)
        kind, data = data[0], data[size:]
    if kind != _UDP:
        raise _LeftOut(_NO_UDP)
    return data


def _number(data: bytes, begin: int) -> int:
    """Two bytes. Raises _LeftOut if they were not captured."""
    if len(data) < begin + 2:
        raise _LeftOut(_IN_PART)
    return int.from_bytes(data[begin : begin + 2])
