"""Captures of packets: a flight in ASTERIX over UDP, as tcpdump and Wireshark would have written it.

The captures are written by `dpkt`, or by hand where it writes none of the kind.
"""

import io
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import dpkt
import pytest

from cogradar.services.errors import BadInput
from cogradar.services.skies.readers.packets import Capture
from cogradar.services.skies.recorded import Recording, recorded
from tests.services.skies.test_readers import PLACE, RANGE_KM, STEP_S, N, check, of_asterix

MIDNIGHT_S = 1_714_521_600  # of 2024-05-01; the flight begins 100 s before the next one
FIRST_S = MIDNIGHT_S + 86_300
ETHERNET, RAW, COOKED, COOKED_2, LOOPBACK, WIFI = 1, 101, 113, 276, 0, 105
FORM = "ASTERIX in packets (pcap), categories 062"


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """The flight's data blocks, one for each position."""
    data = of_asterix(62)(tmp_path_factory.mktemp("blocks")).read_bytes()
    found = list[bytes]()
    while data:
        length = int.from_bytes(data[1:3])
        found.append(data[:length])
        data = data[length:]
    assert len(found) == N
    return found


def udp(payload: bytes) -> dpkt.udp.UDP:
    return dpkt.udp.UDP(sport=1024, dport=8600, ulen=8 + len(payload), data=payload)


def ipv4(payload: bytes) -> bytes:
    return bytes(dpkt.ip.IP(src=b"\x0a\0\0\1", dst=b"\xef\0\0\1", p=dpkt.ip.IP_PROTO_UDP, data=udp(payload)))


def ipv6(payload: bytes) -> bytes:
    """With an option to skip: hop by hop, padding."""
    data = bytes([17, 0, 1, 4, 0, 0, 0, 0]) + bytes(udp(payload))
    return bytes(dpkt.ip6.IP6(src=16 * b"\1", dst=16 * b"\2", nxt=0, plen=len(data), data=data))


def ethernet(ip: bytes, *tags: int) -> bytes:
    """A frame, with a tag for each VLAN, padded to the 60 bytes that go over a cable."""
    kind = 0x0800 if ip[0] >> 4 == 4 else 0x86DD
    frame = bytes(dpkt.ethernet.Ethernet(type=kind, data=ip))
    return (frame[:12] + b"".join(struct.pack(">HH", tag, 5) for tag in tags) + frame[12:]).ljust(60, b"\0")


def pcap(packets: list[tuple[float, bytes]], link: int = ETHERNET, *, nano: bool = False) -> bytes:
    file = io.BytesIO()
    dpkt.pcap.Writer(file, linktype=link, nano=nano).writepkts((t, data) for t, data in packets)
    return file.getvalue()


def big_endian_pcap(packets: list[tuple[float, bytes]], link: int = ETHERNET) -> bytes:
    file = struct.pack(">IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, link)
    for t, data in packets:
        file += struct.pack(">4I", int(t), round(t % 1.0 * 1e6), len(data), len(data)) + data
    return file


def pcapng(packets: list[tuple[float, bytes]], link: int = ETHERNET) -> bytes:
    file = io.BytesIO()
    dpkt.pcapng.Writer(file, linktype=link).writepkts(packets)
    return file.getvalue()


def pcapng_block(kind: int, body: bytes, order: str = "<") -> bytes:
    body += b"\0" * (-len(body) % 4)
    return struct.pack(order + "II", kind, 12 + len(body)) + body + struct.pack(order + "I", 12 + len(body))


def two_interfaces(packets: list[tuple[float, bytes]], link: int = ETHERNET) -> bytes:
    """As Wireshark writes two interfaces: Wi-Fi in microseconds, and the other one in nanoseconds, in big-endian.

    A second section, in little-endian, has the last packet, and its clock counts from some hours later.
    """
    nano = struct.pack(">HHIHHBxxxI", link, 0, 0, 9, 1, 9, 0)
    file = pcapng_block(0x0A0D0D0A, struct.pack(">IHHq", 0x1A2B3C4D, 1, 0, -1), ">")
    file += pcapng_block(1, struct.pack(">HHI", WIFI, 0, 0), ">") + pcapng_block(1, nano, ">")
    file += pcapng_block(5, bytes(12), ">")  # statistics, which are skipped
    for t, data in packets[:-1]:
        ticks = round(t * 1e9)
        for interface, seen in ((1, data), (0, b"\x80\0" + bytes(30))):
            head = struct.pack(">5I", interface, ticks >> 32, ticks & 0xFFFFFFFF, len(seen), len(seen))
            file += pcapng_block(6, head + seen, ">")
    t, data = packets[-1]
    offset = struct.pack("<HHqI", 14, 8, 7200, 0)
    file += pcapng_block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    file += pcapng_block(1, struct.pack("<HHI", link, 0, 65_535) + offset)
    ticks = round((t - 7200) * 1e6)
    return file + pcapng_block(6, struct.pack("<5I", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data)) + data)


def received(blocks: list[bytes], wrap: Callable[[bytes], bytes]) -> list[tuple[float, bytes]]:
    """Each block in a packet, 0.3 s after its time."""
    return [(FIRST_S + STEP_S * i + 0.25, wrap(one)) for i, one in enumerate(blocks)]


def read(content: bytes, tmp_path: Path) -> Recording:
    (tmp_path / "capture.pcap").write_bytes(content)
    return recorded(tmp_path / "capture.pcap", PLACE, RANGE_KM, heights=True)


@pytest.mark.parametrize(
    ("wrap", "link"),
    [
        (lambda one: ethernet(ipv4(one)), ETHERNET),
        (lambda one: ethernet(ipv6(one)), ETHERNET),
        (lambda one: ethernet(ipv4(one), 0x88A8, 0x8100), ETHERNET),
        (lambda one: ethernet(ipv4(one)), 0x1000_0000 + ETHERNET),  # with the length of the check sum in the upper bits
        (lambda one: bytes(dpkt.sll.SLL(ethtype=0x0800, data=ipv4(one))), COOKED),
        (lambda one: bytes(dpkt.sll2.SLL2(ethtype=0x86DD, data=ipv6(one))), COOKED_2),
        (ipv4, RAW),
        (ipv6, RAW),
        (lambda one: struct.pack("<I", 2) + ipv4(one), LOOPBACK),
    ],
)
def test_a_flight_is_read_from_packets_of_each_link(
    wrap: Callable[[bytes], bytes], link: int, blocks: list[bytes], tmp_path: Path
) -> None:
    found = read(pcap(received(blocks, wrap), link), tmp_path)
    check(found)
    assert (found.tally.form, found.begin_utc) == (FORM, "2024-05-01T23:58:40Z")


@pytest.mark.parametrize(
    ("write", "form"),
    [
        (lambda packets: pcap(packets, nano=True), FORM),
        (big_endian_pcap, FORM),
        (pcapng, FORM.replace("pcap", "pcapng")),
        (two_interfaces, FORM.replace("pcap", "pcapng")),
    ],
)
def test_a_flight_is_read_from_each_form(
    write: Callable[[list[tuple[float, bytes]]], bytes], form: str, blocks: list[bytes], tmp_path: Path
) -> None:
    found = read(write(received(blocks, lambda one: ethernet(ipv4(one)))), tmp_path)
    check(found)
    assert (found.tally.form, found.begin_utc) == (form, "2024-05-01T23:58:40Z")
    assert "ASTERIX has no date: the packets give the day" in found.tally.notes
    assert any("39 of 79 packets are left out: they have link type 105" in note for note in found.tally.notes) == (
        write is two_interfaces
    )


def test_packets_without_times_have_no_day(blocks: list[bytes], tmp_path: Path) -> None:
    """Simple packets of pcapng; the interface's limit says how much of one was captured."""
    file = pcapng_block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    file += pcapng_block(1, struct.pack("<HHI", RAW, 0, 200))
    for one in blocks:
        file += pcapng_block(3, struct.pack("<I", len(ipv4(one))) + ipv4(one))
    file += pcapng_block(3, struct.pack("<I", 300) + ipv4(bytes(272))[:200])
    found = read(file, tmp_path)
    check(found)
    assert found.begin_utc is None
    assert any("1 of 41 packets are left out: they were captured in part" in note for note in found.tally.notes)


def test_the_day_is_right_where_the_clocks_differ(blocks: list[bytes], tmp_path: Path) -> None:
    """A recording that was sent again half a day later: the first packet says the day, within half a day."""
    late = [(t + 11 * 3600.0, data) for t, data in received(blocks, ipv4)]
    found = read(pcap(late, RAW), tmp_path)
    check(found)
    assert found.begin_utc == "2024-05-01T23:58:40Z"
    assert any("which came 660 min after what their records say" in note for note in found.tally.notes)


def test_what_is_no_whole_asterix_over_udp_is_left_out_and_counted(blocks: list[bytes], tmp_path: Path) -> None:
    packets = received(blocks, lambda one: ethernet(ipv4(one)))
    fragment, tail = bytearray(packets[3][1]), bytearray(packets[3][1])
    fragment[20], tail[21] = 0x20, 0x10  # more fragments; an offset
    next_header = bytes([17, 0, 0, 1, 0, 0, 0, 1])
    fragment_6 = bytes(dpkt.ip6.IP6(src=16 * b"\1", dst=16 * b"\2", nxt=44, plen=8 + 30, data=next_header + bytes(30)))
    tcp = bytes(dpkt.ip.IP(src=b"\x0a\0\0\1", dst=b"\x0a\0\0\2", p=6, data=dpkt.tcp.TCP(data=blocks[0])))
    others = [bytes(fragment), bytes(tail), ethernet(fragment_6), ethernet(tcp), packets[3][1][:-6]]
    others += [ethernet(ipv4(b"\x12\x34\1\0\0\1\0\0\0\0\0\0\3foo\0\0\1\0\1")), ethernet(ipv4(blocks[0] + b"\0"))]
    others += [ethernet(ipv4(b"")), bytes(dpkt.ethernet.Ethernet(type=0x0806, data=bytes(28)))]
    found = read(pcap([*packets, *((FIRST_S, data) for data in others)]), tmp_path)
    check(found)
    said = [note.split(" of 49 packets are left out: they ") for note in found.tally.notes]
    assert [(one[0], one[1][:18]) for one in said if len(one) == 2] == [
        ("3", "are fragments of l"),
        ("3", "have something els"),
        ("2", "are not UDP over I"),
        ("1", "were captured in p"),
    ]


def test_a_capture_without_asterix_says_what_it_has(blocks: list[bytes], tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"capture of 40 packets without ASTERIX in UDP: 40 have link type 105, must be"):
        read(pcap(received(blocks, ipv4), WIFI), tmp_path)
    with pytest.raises(BadInput, match="capture of 40 packets without ASTERIX in UDP: 40 are fragments of longer ones"):
        read(pcap(received(blocks, lambda one: ipv4(one)[:6] + b"\x20\0" + ipv4(one)[8:]), RAW), tmp_path)
    with pytest.raises(BadInput, match="capture of 0 packets without ASTERIX in UDP: it is empty"):
        read(pcap([]), tmp_path)


def test_a_capture_that_is_cut_short_is_used_up_to_there(blocks: list[bytes], tmp_path: Path) -> None:
    packets = received(blocks, lambda one: ethernet(ipv4(one)))
    for content in (pcap(packets)[:-3], pcapng(packets)[:-3], pcap(packets)[: -len(packets[-1][1]) - 1]):
        found = read(content, tmp_path)
        check(found, kept=N - 1)
        assert any("ends within packet 40" in note for note in found.tally.notes)


def damaged(blocks: list[bytes]) -> Iterator[bytes]:
    """Captures of two packets, each byte in turn another one, or missing with all after it."""
    packets = received(blocks, lambda one: ethernet(ipv6(one), 0x8100))[:2]
    for content in (pcap(packets), two_interfaces(packets)):
        for i in range(len(content)):
            yield content[:i]
            for value in (0x00, 0x2C, 0xFF):
                yield content[:i] + bytes([value]) + content[i + 1 :]


def test_any_damage_is_an_error_or_leaves_packets_out(blocks: list[bytes]) -> None:
    faults = list[str]()
    for content in damaged(blocks):
        capture = Capture(Path("c.pcap"), io.BytesIO(content))
        try:
            assert len(list(capture.datagrams())) <= 2
        except BadInput as error:
            faults.append(str(error))
    assert len(faults) > 50
    assert all(said.startswith("c.pcap: is a damaged capture: after packet") for said in faults)


def test_a_length_that_cannot_be_is_an_error(blocks: list[bytes], tmp_path: Path) -> None:
    content = bytearray(pcap(received(blocks, ipv4), RAW))
    content[24 + 8 : 24 + 12] = b"\xff\xff\xff\xff"
    with pytest.raises(BadInput, match="is a damaged capture: after packet 0 it has lengths that cannot be"):
        read(bytes(content), tmp_path)
