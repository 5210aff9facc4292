"""A run on services with certificates, while whoever should not tries to get in, or to spoil it: its digest stays."""

import datetime
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import zenoh

from cogradar.services import kernels
from cogradar.services.certs import authority
from cogradar.services.metrics.client import ask_service
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.runs import in_process
from cogradar.services.topology import SERVICES, Start
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.messages import (
    Checkpoint,
    Message,
    Plan,
    RunCancel,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from cogradar.shared.protocol.permissions import HOLDERS
from cogradar.shared.protocol.recovery import Handover, ScanRecall, Snapshot
from cogradar.shared.protocol.topics import ALIVE, BY_MESSAGE, PROTOCOL, QUERY, Role
from cogradar.shared.wire.codec import encode
from cogradar.shared.wire.runner import Closing, serve
from cogradar.shared.wire.session import CONFIG_VARIABLE, Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.samples import plan, sample
from tests.services.certs.conftest import HOST, LIMITED, Secured, until
from tests.services.loop import checkpoint, smoke_start

pytestmark = pytest.mark.zenoh

RUN = "under-attack"
DWELLS = 8
FLOOD = 50  # times
BLOCK = zenoh.CongestionControl.BLOCK  # by default Zenoh may drop what is put behind much else
KEPT: list[object] = []  # what was declared
SHORT_S = 0.1  # who is not let in need not try for long


class Services:
    """Every process of the system as a thread of this one, with the certificate of its role."""

    def __init__(self, secured: Secured, store: str) -> None:
        self._secured, self._store = secured, store
        self._stop, self._threads = threading.Event(), list[threading.Thread]()
        self.buses: dict[Role, ZenohBus] = {}

    def start(self, *roles: Role) -> None:
        for role in roles:
            self._threads.append(threading.Thread(target=self._be, args=(role,)))
            self._threads[-1].start()
        assert until(lambda: self.buses.keys() >= set(roles))

    def _be(self, role: Role) -> None:
        make = SERVICES[role].core
        assert make is not None
        core = make(Start(f"{role}.here", self._store, http="off"))
        bus = self.buses[role] = ZenohBus(self._secured.session(role), role, f"{role}.here")
        if isinstance(core, MetricsCore):
            bus.serve_queries(core.answer)
        try:
            serve(core, bus, self._stop, bus.meter)
        finally:
            bus.close()
            if isinstance(core, Closing):
                core.close()

    def end(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()


@pytest.fixture
def services(secured: Secured, tmp_path: Path) -> Iterator[Services]:
    kernels.compile_all(lambda _: None)
    found = Services(secured, str(tmp_path / "store.db"))
    yield found
    found.end()


def _put(session: Session, kind: type[Message], **fields: object) -> None:
    """Send a message that its own sender would not make: nothing is checked."""
    message = sample(kind, run=RUN).model_copy(update=fields)
    session.put(BY_MESSAGE[kind].key_of(message, build()), encode(message), congestion_control=BLOCK)


def _recalls(session: Session) -> None:
    """Twenty kilobytes that once were answered with a gigabyte and a half."""
    for _ in range(FLOOD):
        _put(session, ScanRecall, k=0, targets=[0] * 4096)


def _far_waveform(session: Session) -> None:
    _put(session, Waveform, k=2**31 - 1)


def _phantoms(session: Session) -> None:
    """Runs that there are not, kept for ever by whoever believes in them."""
    for i in range(FLOOD):
        sent = checkpoint(smoke_start(run=f"phantom-{i}")).model_copy(update={"rate_hz": 1e-9})
        plain = Checkpoint(**{name: getattr(checkpoint(smoke_start()), name) for name in Checkpoint.model_fields})
        sent_plain = plain.model_copy(update={"run": sent.run, "rate_hz": 1e-9})
        for message in (sent, sent_plain):
            session.put(BY_MESSAGE[type(message)].key_of(message, build()), encode(message), congestion_control=BLOCK)


def _everything(session: Session) -> None:
    """Every topic, of the run that goes on: ends, cancels, checkpoints, scans, plans."""
    for kind in (RunStart, RunCancel, RunEnd, Checkpoint, Scan, Truth, Plan, Waveform):
        with suppress(ValueError):
            message = sample(kind, run=RUN)
            session.put(BY_MESSAGE[kind].key_of(message, build()), encode(message), congestion_control=BLOCK)


def _show(session: Session, planner: str) -> None:
    """Show a planner alive. A token is there as long as it is kept."""
    name = ALIVE.format(protocol=PROTOCOL, build=build(), role=Role.PLANNER, name=planner)
    KEPT.append(session.liveliness().declare_token(name))


def _stranger(session: Session) -> None:
    """Tokens of planners, which would get tracks, and answers in place of metrics'."""
    _show(session, "planner-9")
    KEPT.append(session.declare_queryable(QUERY.format(metric="*"), lambda query: query.drop(), complete=True))


def _many_planners(session: Session) -> None:
    """Two hundred tokens of one planner's key, which would get most of the tracks."""
    for i in range(200):
        _show(session, f"ghost-{i}")


def _tracks_of_others(session: Session) -> None:
    """With the key of a planner for tracks 9 to 16: plans, snapshots and offers of the first two."""
    for slots in ("0-15", "0-7", "8-15"):
        for track in (0, 1):
            for message in (
                plan(run=RUN, target=track),
                sample(Snapshot, run=RUN, target=track),
                sample(Handover, run=RUN, planner=f"planner-9@{slots}", targets=[track], taken=False, k=10**6),
                sample(Handover, run=RUN, planner=f"planner-9@{slots}", targets=[track], taken=True, k=10**6),
            ):
                key = BY_MESSAGE[type(message)].key_of(message, build(), slots)
                session.put(key, encode(message), congestion_control=BLOCK)
    for name in ("planner-9", "planner-9@0-7", "planner-9@8-15", LIMITED):  # it is let show itself, and no other
        _show(session, name)


# What is done with whose key. What a role may send is sent by others: its own key is trusted with it.
ATTEMPTS: dict[str, tuple[str, Callable[[Session], None]]] = {
    "an observer sends everything": ("observer", _everything),
    "an observer passes for others": ("observer", _stranger),
    "an operator passes for a planner": ("operator", _stranger),
    "a planner shows two hundred tokens": ("planner", _many_planners),
    "a planner asks for the same snapshot 4096 times": ("planner", _recalls),
    "a planner with slots speaks of the tracks of others": (LIMITED, _tracks_of_others),
    "an allocator is two thousand million dwells ahead": ("allocator", _far_waveform),
    "a recorder invents runs that never end": ("recorder", _phantoms),
}
FOREIGN = {  # what a planner's key is refused, each alone: all but plans, snapshots and recalls
    kind.__name__: kind for kind in (RunStart, RunCancel, RunEnd, Checkpoint, Scan, Truth, Waveform)
}


def test_a_run_ends_with_its_digest_whatever_is_tried(
    services: Services, secured: Secured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without an allocator it stands still, and all is tried; then the allocator comes."""
    monkeypatch.setenv(CONFIG_VARIABLE, secured.file("operator"))
    start = smoke_start(dwells=DWELLS, run=RUN)
    services.start(Role.RECORDER, Role.METRICS, Role.EMULATOR, Role.PLANNER)
    bus = ZenohBus(secured.session("operator"), Role.OPERATOR, "operator.here", reads=False)
    sessions = {holder: secured.session(holder) for holder in HOLDERS} | {LIMITED: secured.limited()}
    try:
        bus.publish(start)
        assert until(lambda: _row(secured)["k"] == 0)
        for holder, attempt in ATTEMPTS.values():
            attempt(sessions[holder])
        for kind in FOREIGN.values():
            message = sample(kind, run=RUN)
            sessions["planner"].put(
                BY_MESSAGE[kind].key_of(message, build()), encode(message), congestion_control=BLOCK
            )
        assert until(lambda: services.buses[Role.RECORDER].inbox.bad_of_topic["scanrecall"] == FLOOD)
        assert until(lambda: services.buses[Role.EMULATOR].inbox.bad_of_topic["emulatorcheckpoint"] == FLOOD)
        assert services.buses[Role.EMULATOR].inbox.bad_of_topic["waveform"] == 1
        assert until(lambda: services.buses[Role.RECORDER].inbox.bad_of_topic["plan"] == 2)  # those with its own slots
        assert until(lambda: services.buses[Role.RECORDER].inbox.bad_of_topic["snapshot"] == 2)
        assert until(lambda: services.buses[Role.PLANNER].inbox.bad_of_topic["handover"] == 4)
        assert _row(secured)["status"] == "running"
        assert until(lambda: bus.alive().names[Role.PLANNER] == ["planner.here", LIMITED])
        services.start(Role.ALLOCATOR)
        assert until(lambda: _row(secured)["status"] == "complete", 30.0)
        assert _row(secured)["digest"] == in_process.play(start).run["digest"]
        assert _row(secured)["conflicts"] == 0
    finally:
        bus.close()
        KEPT.clear()
        for session in sessions.values():
            session.close()


def _row(secured: Secured) -> dict[str, Any]:
    rows = ask_service(secured.endpoint, "runs", {"run": RUN})
    return rows[0] if rows else {"k": None, "status": "unknown"}


def _other_authority(folder: Path) -> str:
    authority.create(folder, 2)
    (file,) = authority.issue(folder, ["operator.here"], [], 1)
    return str(file)


def _no_certificate(secured: Secured, folder: Path) -> str:
    text = Path(secured.file("operator")).read_text()
    keys = ("connect_private_key_base64", "connect_certificate_base64", "enable_mtls")
    kept = [line for line in text.splitlines() if not any(key in line for key in keys)]
    folder.mkdir()
    (folder / "zenoh.json5").write_text("\n".join(kept))
    return str(folder / "zenoh.json5")


def _expired(secured: Secured, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(authority, "EARLIER", datetime.timedelta(days=3))
    (file,) = authority.issue(secured.folder, ["operator.late"], [], -1)
    return str(file)


@pytest.mark.parametrize("what", ["no certificate", "of another authority", "expired", "no TLS", "another host"])
def test_who_has_no_valid_certificate_is_not_let_in(
    what: str, secured: Secured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint, file = secured.endpoint, secured.file("operator")
    match what:
        case "no certificate":
            file = _no_certificate(secured, tmp_path / "none")
        case "of another authority":
            file = _other_authority(tmp_path / "other")
        case "expired":
            file = _expired(secured, monkeypatch)
        case "no TLS":
            endpoint = endpoint.replace("tls/", "tcp/")
        case _:  # a router of another name: it may be somebody else's
            endpoint = endpoint.replace(HOST, "localhost")
    with pytest.raises(ConnectionError, match=r"no Zenoh router at .* within"):
        open_session([endpoint], SHORT_S, lambda: None, file=file).close()


def test_a_certificate_that_is_not_listed_may_do_nothing(secured: Secured) -> None:
    """As one that was taken off the list, since its key was stolen."""
    (file,) = authority.issue(secured.folder, ["operator.stolen"], [], 1)
    stolen = open_session([secured.endpoint], 10.0, lambda: None, file=str(file))
    with secured.session("recorder") as reader, secured.session("operator") as operator, stolen:
        seen: list[object] = []
        reader.declare_subscriber(BY_MESSAGE[RunStart].pattern("*"), seen.append)
        message = sample(RunStart, run=RUN)

        def is_seen(sender: Session) -> bool:
            sender.put(BY_MESSAGE[RunStart].key_of(message, build()), encode(message), congestion_control=BLOCK)
            return until(lambda: seen, 0.3)

        assert until(lambda: is_seen(operator))
        seen.clear()
        assert not any(is_seen(stolen) for _ in range(3))
        assert until(lambda: is_seen(operator))
