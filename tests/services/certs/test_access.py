"""Who may do what, tried over a router with certificates: every holder tries all there is."""

import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from cogradar.services.certs import access, names
from cogradar.services.emulator.foreign import OpensForeign
from cogradar.services.errors import BadInput
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.messages import Command, Message, Plan, Scan
from cogradar.shared.protocol.permissions import COMMANDER, HOLDERS, OBSERVER, OF_THE_WORLD, Act, expression, permitted
from cogradar.shared.protocol.recovery import Handover, ScanRecall, Snapshot
from cogradar.shared.protocol.topics import (
    ALIVE,
    BY_MESSAGE,
    EXCHANGES,
    EXPOSITION,
    FRONT_END,
    LINK,
    PROTOCOL,
    QUERY,
    SHARE,
    TIMESTAMPS,
    TOPICS,
    Role,
)
from cogradar.shared.wire import session as wire
from cogradar.shared.wire.bus import Inbox
from cogradar.shared.wire.codec import MAX_BYTES, decode, encode
from cogradar.shared.wire.queries import alive, names_alive
from cogradar.shared.wire.session import CONFIG_VARIABLE, Link
from tests.samples import plan, sample
from tests.services.certs.conftest import LIMITED, Secured, until
from tests.services.loop import checkpoint, play, scans, smoke_start
from tests.zenoh_device import Device, simulated

pytestmark = pytest.mark.zenoh

SETTLE_S = 0.3  # for what must not arrive
FORMS = (QUERY, TIMESTAMPS, EXPOSITION)


def test_the_table_of_topics_is_what_each_role_may_do(secured: Secured) -> None:
    """Every holder subscribes to every topic and sends on every topic: only what the table says arrives."""
    received: set[tuple[str, str, str]] = set()
    with _sessions(secured) as readers, _sessions(secured) as senders:
        for holder, session in readers.items():

            def take(one: zenoh.Sample, holder: str = holder) -> None:
                message = decode(one.payload.to_bytes())
                received.add((BY_MESSAGE[type(message)].name, message.run, holder))

            for topic in TOPICS:
                session.declare_subscriber(topic.pattern("*"), take)
            session.declare_subscriber("cogradar/**", take)
            session.declare_subscriber("**", take)
        expected = {
            (topic.name, str(holder), reader)
            for topic in TOPICS
            for holder in HOLDERS
            if holder == topic.producer or (topic.message is Command and holder in {COMMANDER, Role.METRICS})
            for reader in _readers(topic.message)
        }

        def sent() -> bool:
            for holder, session in senders.items():
                for topic in TOPICS:
                    message = sample(topic.message, run=holder)
                    _put(session, topic.key_of(message, build()), encode(message))
            time.sleep(SETTLE_S)
            return received >= expected

        assert until(sent)  # a subscription takes its time, more on a busy machine
        assert sent()
        assert received == expected


def _put(session: zenoh.Session, key: str, payload: bytes) -> None:
    session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK, express=True)


@contextmanager
def _sessions(secured: Secured) -> Iterator[dict[str, zenoh.Session]]:
    """One of each holder; what a session sends to itself no router sees, so who tries something needs two."""
    with ExitStack() as opened:
        yield {holder: opened.enter_context(secured.session(holder)) for holder in HOLDERS}


def _readers(message: type[Message]) -> set[str]:
    observers = set() if message in OF_THE_WORLD else {OBSERVER, COMMANDER}
    return {*map(str, BY_MESSAGE[message].readers), *observers}


def test_nobody_passes_for_another_role_or_answers_in_its_place(secured: Secured) -> None:
    """Each holder shows tokens of every role and answers every question; metrics, operator and observer ask.

    Under the name on its certificate: any other name is dropped, whatever the role.
    """
    kept: list[Any] = []
    with _sessions(secured) as askers, _sessions(secured) as sessions:
        for holder, session in sessions.items():
            for role in Role:
                for name in (f"{holder}.here", f"{holder}.there", f"{role}.here"):
                    kept.append(session.liveliness().declare_token(_key(ALIVE, role, name)))
                    kept += [_answering(session, _key(form, role, name), holder) for form in (TIMESTAMPS, EXPOSITION)]
            kept.append(_answering(session, QUERY.format(metric="runs"), holder))
        processes = set(HOLDERS) - {OBSERVER, COMMANDER, FRONT_END, Role.ROUTER}
        shown = {role: [f"{role}.here"] for role in Role if role in processes}
        seeing = [session for holder, session in askers.items() if holder != FRONT_END]
        assert until(lambda: all(alive(session, build()).names == shown for session in seeing))
        time.sleep(SETTLE_S)
        assert not alive(askers[FRONT_END], build()).names
        for session in seeing:
            assert alive(session, build()).names == shown
        own = {f"{role}/{role}.here/{role}" for role in processes}
        expected: dict[tuple[str, str], set[str]] = {(asker, form): set() for asker in HOLDERS for form in FORMS}
        expected |= {(asker, QUERY): {"metrics"} for asker in (Role.OPERATOR, Role.METRICS, OBSERVER, COMMANDER)}
        expected |= {(Role.OPERATOR, TIMESTAMPS): own, (Role.METRICS, EXPOSITION): own}
        assert {(asker, form): _answers(askers[asker], form) for asker in HOLDERS for form in FORMS} == expected


def test_each_process_is_told_that_the_router_sees_it(secured: Secured, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire, "ASK_S", 0.1)
    processes = set(HOLDERS) - {OBSERVER, COMMANDER, FRONT_END, Role.ROUTER}
    with _sessions(secured) as sessions:
        watched = {}
        for holder in processes:
            shown = _key(ALIVE, holder, f"{holder}.here")
            token = sessions[holder].liveliness().declare_token(shown)
            watched[holder] = token, Link(sessions[holder], Role(holder), f"{holder}.here")
        assert until(lambda: not any(one.is_broken() for _, one in watched.values()) and _all_known(watched))


def _all_known(watched: dict[str, tuple[Any, Link]]) -> bool:
    return all(one._known for _, one in watched.values())


def _key(form: str, role: str, name: str) -> str:
    return form.format(protocol=PROTOCOL, build=build(), role=role, name=name)


def _answering(session: zenoh.Session, key: str, holder: str) -> Any:
    def answer(query: zenoh.Query) -> None:
        with query:
            of_role = "" if key == QUERY.format(metric="runs") else "/".join(key.split("/")[3:5]) + "/"
            query.reply(key, (of_role + holder).encode())

    return session.declare_queryable(key, answer, complete=True)


def _answers(session: zenoh.Session, form: str) -> set[str]:
    key = QUERY.format(metric="runs") if form is QUERY else re.sub(r"\{\w+\}", "*", form)
    replies = session.get(key, target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE, timeout=2.0)
    found = {reply.ok.payload.to_string() for reply in replies if reply.ok is not None}
    return {text for text in found if text and not text.startswith("{")}  # the router answers for itself


def test_a_planner_with_slots_says_nothing_of_other_tracks(secured: Secured) -> None:
    """On any key: what the router lets pass is on a key with its slots, and there no reader believes it."""
    inbox, kept = Inbox(build()), list[Any]()
    received: set[tuple[str, str]] = set()
    own = LIMITED.partition("@")[0]
    limits = ("", "@0-15", "@0-7", "@8-9", "@8-15")
    tokens = [_key(ALIVE, Role.PLANNER, name) for name in (*(own + limit for limit in limits), "q@8-15")]
    with secured.limited() as planner, _sessions(secured) as readers:
        for holder in (Role.ALLOCATOR, Role.RECORDER, Role.PLANNER):
            for topic in TOPICS:

                def take(one: zenoh.Sample, holder: str = holder) -> None:
                    said = inbox.open(str(one.key_expr), one.payload.to_bytes())
                    received.update((holder, f"{type(m).__name__} {_tracks(m)} {str(one.key_expr)[-5:]}") for m in said)

                readers[holder].declare_subscriber(topic.pattern("*"), take)
        kept += [planner.liveliness().declare_token(token) for token in tokens]
        messages = [
            *(plan(target=target) for target in (0, 7, 8, 15, 24)),
            *(sample(Snapshot, target=target) for target in (0, 8)),
            *(
                sample(kind, planner=f"p{limit}", targets=[m])
                for kind in (Handover, ScanRecall)
                for limit in ("", "@0-7", "@8-15")
                for m in (0, 8)
            ),
        ]
        expected = {(reader, f"Plan {m} /8-15") for reader in (Role.ALLOCATOR, Role.RECORDER) for m in (8, 15, 24)}
        expected |= {(Role.RECORDER, f"{said} /8-15") for said in ("Snapshot 8", "ScanRecall [8]")}
        expected |= {(Role.PLANNER, "Handover [8] /8-15")}

        def sent() -> bool:
            for message in messages:
                for slots in ("0-15", "0-7", "8-15", "8-8", "*"):
                    key = BY_MESSAGE[type(message)].key_of(message, build(), slots.replace("*", "x"))
                    _put(planner, key, encode(message))
            time.sleep(SETTLE_S)
            return received >= expected

        assert until(sent)
        assert sent()
        assert received == expected
        assert alive(readers[Role.OPERATOR], build()).names == {Role.PLANNER: [LIMITED]}


def test_of_many_tokens_of_one_certificate_one_counts(secured: Secured) -> None:
    """Two hundred names of a planner once were given tracks. Claims to runs and builds are under its name, too."""
    names = [f"ghost-{i}" for i in range(200)]
    with secured.session(Role.PLANNER) as planner, secured.session(Role.ALLOCATOR) as allocator:
        kept = [planner.liveliness().declare_token(_key(ALIVE, Role.PLANNER, name)) for name in names]
        for name in ("ghost", "allocator.here"):
            share = SHARE.format(
                protocol=PROTOCOL, build=build(), role=Role.ALLOCATOR, shard=3, moment=f"{1:020d}-00000000", name=name
            )
            kept.append(allocator.liveliness().declare_token(share))
        strange = [
            ALIVE.format(protocol=PROTOCOL, build=f"b{i}", role=Role.PLANNER, name="planner.here") for i in (1, 2)
        ]
        kept += [
            planner.liveliness().declare_token(key) for key in (*strange, _key(ALIVE, Role.PLANNER, "planner.here"))
        ]
        with secured.session(Role.PLANNER) as reader:
            assert until(lambda: names_alive(reader, build(), Role.PLANNER) == ["planner.here"])
            time.sleep(SETTLE_S)
            assert names_alive(reader, build(), Role.PLANNER) == ["planner.here"]
            assert len(alive(reader, build()).strangers) == 1
        with secured.session(Role.ALLOCATOR) as reader:
            shares = reader.liveliness().get(re.sub(r"\{\w+\}", "*", SHARE), timeout=2.0)
            assert {str(one.ok.key_expr).split("/")[-1] for one in shares if one.ok is not None} == {"allocator.here"}
        for token in kept:
            token.undeclare()


def _tracks(message: Message) -> object:
    return getattr(message, "target", getattr(message, "targets", None))


def test_only_the_emulator_asks_front_ends_and_each_answers_for_its_own_name(secured: Secured) -> None:
    """Every holder answers for two front ends, and every one asks both; a question may hold a large waveform."""
    kept: list[Any] = []
    keys = [one.key_of(name) for one in EXCHANGES for name in ("here", "there")]
    with _sessions(secured) as askers, _sessions(secured) as sessions:
        for holder, session in sessions.items():
            kept += [_answering(session, key, holder) for key in keys]

        def answers(holder: str, key: str) -> set[str]:
            replies = askers[holder].get(
                key, target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE, payload=bytes(1 << 20)
            )
            return {reply.ok.payload.to_string() for reply in replies if reply.ok is not None}

        assert until(lambda: all(answers(Role.EMULATOR, one.key_of("here")) for one in EXCHANGES))
        time.sleep(SETTLE_S)
        found = {(holder, key): answers(holder, key) for holder in HOLDERS for key in keys}
    expected = {
        (Role.EMULATOR, one.key_of("here")): {f"here/{one.key.rpartition('/')[2]}/frontend"} for one in EXCHANGES
    }
    assert {asked: said for asked, said in found.items() if said} == expected


def test_a_run_with_a_front_end_behind_certificates_is_the_run_in_process(
    secured: Secured, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = smoke_start()
    without_world = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    monkeypatch.setenv(CONFIG_VARIABLE, secured.file(Role.EMULATOR))
    with Device(simulated(checkpoint(start)), name="here", opens=lambda: secured.session(FRONT_END)):
        over_zenoh = play(without_world, OpensForeign("here", [secured.endpoint]))
    assert [encode(scan) for scan in scans(over_zenoh)] == [encode(scan) for scan in scans(play(start))]


def test_what_is_too_long_is_not_passed_on(secured: Secured) -> None:
    key, received = BY_MESSAGE[Scan].pattern("*").replace("*", "r"), list[int]()
    with secured.session(Role.EMULATOR) as sender, secured.session(Role.RECORDER) as reader:
        reader.declare_subscriber(BY_MESSAGE[Scan].pattern("*"), lambda one: received.append(len(one.payload)))

        def sent() -> bool:
            for n_byte in (MAX_BYTES + 1, MAX_BYTES, 1):
                _put(sender, key, bytes(n_byte))
            time.sleep(SETTLE_S)
            return len(received) > 1

        assert until(sent)
        assert set(received) == {MAX_BYTES, 1}


def test_truth_and_questions_are_for_few() -> None:
    """What the tests above try is the table, so the table itself must say what it should."""
    reading = {holder: set(permitted(holder).get(Act.READ, ())) for holder in HOLDERS}
    truth = next(topic.pattern("*") for topic in TOPICS if topic.name == "truth")
    assert {holder for holder, keys in reading.items() if truth in keys} == {Role.RECORDER}
    questions = {holder: set(permitted(holder).get(Act.ASK, ())) - {expression(LINK)} for holder in HOLDERS}
    asking = {holder for holder, keys in questions.items() if keys}
    assert asking == {Role.OPERATOR, Role.METRICS, Role.EMULATOR, OBSERVER, COMMANDER}
    assert set(permitted(OBSERVER)) == {Act.READ, Act.ASK, Act.SEE}
    assert permitted(COMMANDER) == permitted(OBSERVER) | {Act.SEND: (BY_MESSAGE[Command].pattern("*"),)}
    assert set(permitted(Role.ROUTER)) == {Act.SEE}


def test_a_limited_planner_is_another_subject() -> None:
    control = access.access_control(["planner.a", "planner.b@0-7", "planner.c@8-15", "planner.d@0-7"])
    assert _policies(control) == {
        "planner": ["planner.a"],
        "planner@0-7": ["planner.b@0-7", "planner.d@0-7"],
        "planner@8-15": ["planner.c@8-15"],
        **{name: [name] for name in ("planner.a", "planner.b@0-7", "planner.c@8-15", "planner.d@0-7")},
    }
    assert len({rule["id"] for rule in control["rules"]}) == len(control["rules"])
    rules = {rule["id"]: rule["key_exprs"] for rule in control["rules"]}
    plans = [key for key in rules["planner@0-7-send-ingress"] if "/plan/" in key]
    assert plans == [BY_MESSAGE[Plan].pattern("*", slots="0-7")]


def _policies(control: dict[str, Any]) -> dict[str, list[str]]:
    """The names on certificates that each set of rules is for."""
    names = {subject["id"]: subject["cert_common_names"] for subject in control["subjects"]}
    return {
        one["rules"][0].rpartition("-")[0].rpartition("-")[0]: [name for of in one["subjects"] for name in names[of]]
        for one in control["policies"]
    }


@pytest.mark.parametrize("name", ["planner.a@", "planner.a@7-0", "planner.a@0-16", "planner.a@3", "recorder.a@0-7"])
def test_slots_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(BadInput, match=r"behind @ are a planner's slots, FIRST-LAST of 0-15"):
        names.holder_of(name)


def test_a_role_without_a_certificate_stands_for_nobody() -> None:
    control = access.access_control(["planner.a", "planner.b", "observer.c"])
    assert control["default_permission"] == "deny"
    assert _policies(control) == {
        "planner": ["planner.a", "planner.b"],
        "observer": ["observer.c"],
        "planner.a": ["planner.a"],
        "planner.b": ["planner.b"],
    }
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "no such file"),
        ("# nobody\n", "no name in it, so no process could connect"),
        ("planner.a\npilot.b\n", r"line 2: 'pilot\.b': must be ROLE\.NAME"),
    ],
)
def test_a_list_that_makes_no_sense_is_refused(text: str | None, said: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "allowed").write_text(text)
    with pytest.raises(BadInput, match=f"(?i){said}"):
        names.allowed(str(tmp_path / "allowed"))


def test_remarks_and_repeats_in_the_list_are_nothing(tmp_path: Path) -> None:
    (tmp_path / "allowed").write_text("planner.a # stays\n\n  planner.a\nmetrics.b\n")
    assert names.allowed(str(tmp_path / "allowed")) == ["planner.a", "metrics.b"]
