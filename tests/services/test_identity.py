"""Who may take part: one process of a kind where there is to be one, and of one build."""

import logging
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path
from threading import Barrier

import pytest

from cogradar.services import process
from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs.cluster import wait_until_alive
from cogradar.services.topology import SERVICES, Start
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.events import Event, Membership
from cogradar.shared.protocol.messages import Plan, Scan
from cogradar.shared.protocol.topics import ALIVE, BY_MESSAGE, PROTOCOL, Role
from cogradar.shared.wire import queries
from cogradar.shared.wire.codec import encode
from cogradar.shared.wire.queries import Claim, alive
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests import samples
from tests.samples import sample

ROUNDS = 8  # fifty take a minute

pytestmark = pytest.mark.zenoh


@contextmanager
def _seen(router: str, role: Role, name: str, its_build: str = "", protocol: int = PROTOCOL) -> Iterator[None]:
    """A process that shows itself alive."""
    with open_session([router], 10.0, lambda: None) as session:
        key = ALIVE.format(protocol=protocol, build=its_build or build(), role=role, name=name)
        token = session.liveliness().declare_token(key)
        with open_session([router], 10.0, lambda: None) as other:
            while not any(reply.ok is not None for reply in other.liveliness().get(key)):
                time.sleep(0.01)
        yield
        token.undeclare()


@pytest.fixture
def session(router: str) -> Iterator[Session]:
    """A process that is about to take part."""
    with open_session([router], 10.0, lambda: None) as opened:
        yield opened


def _enter(role: Role, session: Session) -> None:
    process._check_others(SERVICES[role], Start("newcomer"), session, lambda: None)


@pytest.mark.parametrize("role", [Role.RECORDER, Role.METRICS])
def test_a_second_one_is_refused_and_told_who_is_there(
    role: Role, router: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "HOLDER_WITHIN_S", 0.2)
    with _seen(router, role, "first"), pytest.raises(BadInput, match=f"^another {role} is there already: first; stop"):
        _enter(role, session)
    monkeypatch.undo()
    _enter(role, session)  # it is gone


@pytest.mark.parametrize(
    ("role", "names"),
    [
        (Role.RECORDER, ("a", "b", "c")),
        (Role.PLANNER, ("a", "a", "a")),
        (Role.EMULATOR, ("a", "a", "a")),
        (Role.ALLOCATOR, ("a",) * 6),
    ],
)
def test_of_several_that_start_at_once_one_lives(
    role: Role, names: tuple[str, ...], router: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a role that several may have, if they have one name: copies of a certificate, or of a unit of systemd."""
    monkeypatch.setattr(process, "HOLDER_WITHIN_S", 0.6)
    monkeypatch.setattr(process, "SETTLE_S", 0.0)  # there is one router
    ready, looked = Barrier(len(names)), Barrier(len(names))

    def start(name: str) -> str:
        """It shows itself alive as soon as it may, and stays until all have looked."""
        with open_session([router], 10.0, lambda: None) as session:
            ready.wait(30.0)
            try:
                claim = process._check_others(SERVICES[role], Start(name), session, lambda: None)
                key = ALIVE.format(protocol=PROTOCOL, build=build(), role=role, name=name)
                token = session.liveliness().declare_token(key)
            except BadInput as error:
                looked.wait(30.0)
                return str(error)
            looked.wait(30.0)
            token.undeclare()
            assert claim is not None  # it is shown as long as somebody has it
            claim.drop()
            return ""

    for _ in range(ROUNDS):
        with ThreadPoolExecutor(len(names)) as threads:
            said = list(threads.map(start, names))
        assert said.count("") == 1
        (winner,) = [name for name, text in zip(names, said, strict=True) if not text]
        assert all(winner in text.partition(f"another {role} is there already")[2] for text in said if text)
        while _is_seen(router):
            time.sleep(0.01)


def test_who_cannot_see_all_others_claims_nothing(
    router: str, session: Session, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Of what a busy router says in time, a part may be missing: here the first five answers to two questions each."""
    monkeypatch.setattr(process, "HOLDER_WITHIN_S", 0.2)
    n_asked, shown, look, show = count(), list[int](), queries.look, Claim.show

    def cut_off(asked: Session, pattern: str) -> tuple[list[str], bool]:
        return ([], False) if next(n_asked) < 10 else look(asked, pattern)

    def told(claim: Claim) -> None:
        shown.append(next(n_asked))
        show(claim)

    monkeypatch.setattr(queries, "look", cut_off)
    monkeypatch.setattr(Claim, "show", told)
    with _seen(router, Role.METRICS, "first"), pytest.raises(BadInput, match=r"^another metrics is there already"):
        _enter(Role.METRICS, session)
    assert shown == []
    assert caplog.text.count("the router answers late") == 1


def test_a_rival_that_is_seen_counts_although_others_may_be_missing(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "HOLDER_WITHIN_S", 0.2)
    monkeypatch.setattr(queries, "look", lambda *_: (["a/b/first"], False))
    with pytest.raises(BadInput, match=r"^another metrics is there already: first"):
        _enter(Role.METRICS, session)


def test_what_comes_too_late_is_said_to_be_missing(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    key = ALIVE.format(protocol=PROTOCOL, build="*", role=Role.METRICS, name="*")
    assert queries.look(session, key) == ([], True)
    monkeypatch.setattr(queries, "LOOK_S", 1e-9)
    assert queries.look(session, key)[1] is False


def test_a_clock_that_is_behind_takes_no_role(router: str, session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one that was first has its claim, and does not show itself alive yet."""
    monkeypatch.setattr(process, "HOLDER_WITHIN_S", 0.5)
    claim = process._check_others(SERVICES[Role.METRICS], Start("first"), session, lambda: None)
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    with (
        open_session([router], 10.0, lambda: None) as other,
        pytest.raises(BadInput, match=r"^another metrics is there already: first; stop"),
    ):
        _enter(Role.METRICS, other)
    assert claim is not None
    claim.drop()
    _enter(Role.METRICS, session)


def _is_seen(router: str) -> bool:
    with open_session([router], 10.0, lambda: None) as session:
        return bool(alive(session, build()).names)


def test_others_may_be_many(router: str, session: Session) -> None:
    for role in (Role.PLANNER, Role.EMULATOR, Role.ALLOCATOR, Role.OPERATOR):
        with _seen(router, role, "first"):
            _enter(role, session)


def test_a_second_process_of_one_name_is_refused(
    router: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of one that was given a copy of another one's certificate: both would be taken for one."""
    monkeypatch.setattr(process, "HOLDER_WITHIN_S", 0.2)
    for role in (Role.PLANNER, Role.EMULATOR, Role.ALLOCATOR):
        said = f"^another {role} is there already under the name newcomer: use another --name or certificate$"
        with _seen(router, role, "newcomer"), pytest.raises(BadInput, match=said):
            _enter(role, session)


def test_a_process_of_another_build_or_protocol_is_named(
    router: str, session: Session, caplog: pytest.LogCaptureFixture
) -> None:
    with (
        _seen(router, Role.RECORDER, "recorder-1"),
        _seen(router, Role.PLANNER, "planner-7", "1f3a"),
        _seen(router, Role.PLANNER, "planner-8", protocol=99),
        caplog.at_level(logging.WARNING),
    ):
        _enter(Role.PLANNER, session)
        there = alive(session, build())
    missing = f"emulator; planner-7 runs build 1f3a, this system {build()}; planner-8 speaks protocol 99"
    with pytest.raises(RunFailed, match=f"^not alive within 0 s: metrics, {missing}"):
        wait_until_alive(lambda: there, ("metrics", "emulator"), lambda: None, lambda _: None, 0.1)
    assert there.names == {Role.RECORDER: ["recorder-1"]}
    assert f"planner-7 runs build 1f3a, this system {build()}: they do not hear each other" in caplog.text


def test_who_comes_with_another_build_is_told_that_it_takes_part_in_nothing(
    router: str, session: Session, caplog: pytest.LogCaptureFixture
) -> None:
    with _seen(router, Role.RECORDER, "recorder-1", "9c2e"), caplog.at_level(logging.WARNING):
        _enter(Role.PLANNER, session)
    assert f"newcomer runs build {build()}, this system 9c2e: it takes part in nothing" in caplog.text


def test_who_computes_otherwise_is_told_that_it_takes_part_in_nothing(
    router: str, session: Session, caplog: pytest.LogCaptureFixture
) -> None:
    own, _, arithmetic = build().partition("-")
    with _seen(router, Role.RECORDER, "recorder-1", f"{own}-0a1b2c3d"), caplog.at_level(logging.WARNING):
        _enter(Role.PLANNER, session)
    assert f"newcomer computes otherwise (arithmetic {arithmetic}, this system 0a1b2c3d)" in caplog.text


def test_what_another_build_says_is_not_heard(router: str, session: Session) -> None:
    bus, plan = ZenohBus(open_session([router], 10.0, lambda: None), Role.ALLOCATOR, "a"), samples.plan()
    foreign = plan.model_copy(update={"k": plan.k + 1})
    received: list[Event | None] = []
    try:
        while plan not in received:  # the subscription takes a moment
            session.put(BY_MESSAGE[Plan].key_of(foreign, "1f3a"), encode(foreign))
            session.put(BY_MESSAGE[Plan].key_of(plan, build()), encode(plan))
            received.append(bus.receive(0.1))
    finally:
        bus.close()
    assert foreign not in received


def test_a_planner_knows_all_planners_before_it_hears_of_a_run(router: str, session: Session) -> None:
    """Who knew only some of them would take tracks that are others'."""
    with _seen(router, Role.PLANNER, "a"), _seen(router, Role.PLANNER, "c"), _seen(router, Role.PLANNER, "x", "1f3a"):
        bus = ZenohBus(open_session([router], 10.0, lambda: None), Role.PLANNER, "b")
        try:
            received: list[Event | None] = []
            while sample(Scan) not in received:
                session.put(BY_MESSAGE[Scan].key_of(sample(Scan), build()), encode(sample(Scan)))
                received.append(bus.receive(0.1))
            assert [event for event in received if event is not None] == [
                Membership(Role.PLANNER, ("a", "b", "c")),
                sample(Scan),
            ]
        finally:
            bus.close()


def test_a_successor_whose_clock_is_behind_stays(router: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of two recorders, one of which was frozen while a server gave its journal to the other: the journal says which
    is the later one. Before, the one with the later clock stayed, and found that its journal is the other's.
    """
    monkeypatch.setattr("cogradar.shared.wire.queries.STAYS_S", 0.2)
    claims = list[Claim]()
    with ExitStack() as opened:
        for hours in (2, 0):  # how far the clocks are ahead
            now_ns = time.time_ns() + hours * 3600 * 10**9
            with monkeypatch.context() as clock:
                clock.setattr(time, "time_ns", lambda now_ns=now_ns: now_ns)
                core = Recorder(Journal(str(tmp_path / "runs.db")))
                core.close()
                other = opened.enter_context(open_session([router], 10.0, lambda: None))
                start = Start(f"recorder-{hours}")
                claim = process._check_others(SERVICES[Role.RECORDER], start, other, lambda: None, core.epoch)
            assert claim is not None
            claim.watch()
            claims.append(claim)
            if hours and claim._token is not None:
                claim._token.undeclare()  # it is frozen, and seems to be gone
        claims[0].show()
        until_s = time.monotonic() + 5.0
        while not claims[0].successor():
            assert time.monotonic() < until_s
            time.sleep(0.02)
        assert [claim.successor() for claim in claims] == ["recorder-0", ""]
        for claim in claims:
            claim.drop()


def test_a_later_claim_that_stays_is_a_successor(
    router: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that withdraws at once, as of several that start together, is none; nor is an earlier one."""
    monkeypatch.setattr("cogradar.shared.wire.queries.STAYS_S", 0.4)
    earlier = Claim(session, Role.RECORDER, "a")
    claim = Claim(session, Role.RECORDER, "b")
    claim.show()
    claim.watch()
    with open_session([router], 10.0, lambda: None) as other:
        later = Claim(other, Role.RECORDER, "c")
        for stays_s, found in ((0.0, {""}), (0.6, {"", "c"})):
            later.show()
            seen, until_s = set[str](), time.monotonic() + 0.2 + stays_s
            while time.monotonic() < until_s:
                seen.add(claim.successor())
                time.sleep(0.02)
            later.drop()
            assert seen == found
        earlier.show()
        time.sleep(0.6)
        assert claim.successor() == ""
    claim.drop()
    earlier.drop()
