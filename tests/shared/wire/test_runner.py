"""The main loop: events go to the core, its answers to the bus; refusals are dropped, errors end the process."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import pytest

from cogradar.shared.protocol.events import Event, Membership, Tick
from cogradar.shared.protocol.messages import Message, Plan, Refused
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire import runner
from cogradar.shared.wire.bus import LocalBus, LocalNetwork
from cogradar.shared.wire.meter import Meter
from cogradar.shared.wire.runner import TICK_S, Flush, serve, step
from tests.samples import plan


class Scripted:
    """A core that does what a test says, and keeps what it was handed."""

    def __init__(self, answer: Callable[[Event], Iterable[Message | Flush]]) -> None:
        self.handled: list[Event] = []
        self._answer = answer

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        self.handled.append(event)
        return self._answer(event)


def refuse_odd(event: Event) -> Sequence[Message]:
    if isinstance(event, Plan) and event.k % 2:
        raise Refused(f"k = {event.k}: odd")
    return []


def network() -> tuple[LocalNetwork, LocalBus]:
    net = LocalNetwork()
    return net, net.endpoint(Role.ALLOCATOR, "a")


def test_a_step_handles_one_event_and_publishes_the_answers_in_order() -> None:
    net, bus = network()
    metrics = net.endpoint(Role.RECORDER, "m")
    core = Scripted(lambda _: [plan(10), plan(11)] if len(core.handled) == 1 else [])
    bus.publish(plan(0))
    assert metrics.receive(0.0) == plan(0)
    assert step(core, bus, 0.0)
    assert [metrics.receive(0.0) for _ in range(3)] == [plan(10), plan(11), None]
    assert step(core, bus, 0.0)  # an allocator reads plans, so also the answers
    assert step(core, bus, 0.0)
    assert not step(core, bus, 0.0)
    assert core.handled == [plan(0), plan(10), plan(11)]


def test_refused_messages_are_dropped_counted_and_the_loop_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    _, bus = network()
    core = Scripted(refuse_odd)
    for k in range(4):
        bus.publish(plan(k))
    assert all(step(core, bus, 0.0) for _ in range(4))
    assert core.handled == [plan(k) for k in range(4)]
    assert dict(bus.inbox.bad) == {"cogradar/10/local/run/run-1/plan/0-15": 2}
    assert [record.getMessage() for record in caplog.records] == [
        "dropping messages on cogradar/10/local/run/run-1/plan/0-15, the first: run-1: k = 1: odd"
    ]


def test_members_cannot_be_refused() -> None:
    bus = LocalNetwork().endpoint(Role.PLANNER, "p")

    def refuse(event: Event) -> Sequence[Message]:
        assert isinstance(event, Membership)
        raise Refused("too many")

    with pytest.raises(Refused, match="too many"):
        step(Scripted(refuse), bus, 0.0)


def test_serve_goes_on_until_stopped() -> None:
    _, bus = network()
    stop = threading.Event()

    def stop_at_the_third(event: Event) -> Sequence[Message]:
        if isinstance(event, Plan) and event.k == 2:
            stop.set()
        return []

    core = Scripted(stop_at_the_third)
    for k in range(5):
        bus.publish(plan(k))
    serve(core, bus, stop, Meter(Role.ALLOCATOR))
    assert core.handled == [plan(0), plan(1), plan(2)]
    assert bus.receive(0.0) == plan(3)


def test_a_stop_is_noticed_while_nothing_arrives() -> None:
    _, bus = network()
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(Scripted(lambda _: []), bus, stop, Meter(Role.ALLOCATOR)))
    thread.start()
    time.sleep(0.05)
    assert thread.is_alive()
    stop.set()
    thread.join(5.0)
    assert not thread.is_alive()


@pytest.mark.parametrize("error", [ValueError("a bug"), ZeroDivisionError(), KeyError("k")])
def test_an_error_in_a_core_ends_serving(error: Exception) -> None:
    """Only Refused, a ValueError of its own, is for messages; a plain ValueError is a bug and must be seen."""
    _, bus = network()

    def fail(_: Event) -> Sequence[Message]:
        raise error

    bus.publish(plan())
    with pytest.raises(type(error)):
        serve(Scripted(fail), bus, threading.Event(), Meter(Role.ALLOCATOR))
    assert not bus.inbox.bad


def test_messages_go_out_before_the_next_one_is_made_where_the_core_says_so() -> None:
    net, bus = network()
    metrics = net.endpoint(Role.RECORDER, "m")
    seen: list[Event | None] = []

    def in_lots(_: Event) -> Iterator[Message | Flush]:
        yield plan(10)
        yield plan(11)
        seen.append(metrics.receive(0.0))
        yield Flush()
        seen.extend(metrics.receive(0.0) for _ in range(3))
        yield plan(12)

    bus.publish(plan(0))
    assert metrics.receive(0.0) == plan(0)
    step(Scripted(in_lots), bus, 0.0)
    assert seen == [None, plan(10), plan(11), None]
    assert metrics.receive(0.0) == plan(12)


class _Clock:
    """A clock that goes on while the loop waits, and not while it works: a busy machine changes no tick."""

    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> _Clock:
    clock = _Clock()
    monkeypatch.setattr(runner, "time", clock)
    return clock


class Timed(Scripted):
    """A core that wants a tick a while after it was handed something, and once."""

    def __init__(self, stop: threading.Event, wanted_s: float) -> None:
        super().__init__(lambda _: [])
        self.wanted_s, self.ticks = wanted_s, list[float]()
        self.wake_s: float | None = self.wanted_s
        self._stop = stop

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        if isinstance(event, Tick):
            self.ticks.append(event.now_s)
            self.wake_s = None
            self._stop.set()
        return super().handle(event)


class Deferring(Scripted):
    """A core that puts everything off until a tick, the second of which ends the test."""

    def __init__(self, stop: threading.Event) -> None:
        super().__init__(lambda _: [])
        self.has_deferred, self.ticks = False, list[float]()
        self._stop = stop

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        self.has_deferred = isinstance(event, Plan)
        if isinstance(event, Tick):
            self.ticks.append(event.now_s)
            if len(self.ticks) == 2:
                self._stop.set()
        return super().handle(event)


def test_a_core_is_woken_when_it_wants_and_not_before(clock: _Clock) -> None:
    _, bus = network()
    stop = threading.Event()
    core = Timed(stop, clock.now_s + 0.05)
    serve(core, _Patient(bus, clock), stop, Meter(Role.ALLOCATOR))
    assert core.ticks == [core.wanted_s]  # not at TICK_S, which it did not ask for


def test_a_core_that_is_overdue_gets_its_tick_after_the_next_message(clock: _Clock) -> None:
    _, bus = network()
    stop = threading.Event()
    for k in range(5):
        bus.publish(plan(k))
    core = Timed(stop, clock.now_s - 1.0)
    serve(core, bus, stop, Meter(Role.ALLOCATOR))
    assert [type(event) for event in core.handled] == [Plan, Tick]


def test_a_core_that_puts_work_off_gets_a_tick_once_no_message_waits_and_then_no_more(clock: _Clock) -> None:
    _, bus = network()
    stop = threading.Event()
    for k in range(5):
        bus.publish(plan(k))
    core, began = Deferring(stop), clock.now_s
    serve(core, _Patient(bus, clock), stop, Meter(Role.ALLOCATOR))
    assert [type(event) for event in core.handled] == [*[Plan] * 5, Tick, Tick]
    assert core.ticks == [began, began + TICK_S]


class Provident(Scripted):
    """A core that has so much to prepare after each event; notes it among the events."""

    def __init__(self, stop: threading.Event, to_do: int, meanwhile: Callable[[], None] = lambda: None) -> None:
        """`meanwhile` is what happens while it prepares for the second time."""
        super().__init__(lambda _: [])
        self.log: list[str] = []
        self._meanwhile = meanwhile
        self._stop, self._to_do, self._left = stop, to_do, 0

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        self.log.append(type(event).__name__)
        self._left = self._to_do
        if isinstance(event, Tick):
            self._stop.set()
        return []

    def prepare(self) -> bool:
        if self.log == ["Plan", "prepared"]:
            self._meanwhile()
        self._left -= 1
        self.log.append("prepared" if self._left >= 0 else "nothing to do")
        return self._left >= 0


def test_a_core_prepares_while_nothing_waits_and_until_it_is_done(clock: _Clock) -> None:
    _, bus = network()
    stop = threading.Event()
    core = Provident(stop, to_do=2)
    for k in range(3):
        bus.publish(plan(k))
    serve(core, _Patient(bus, clock), stop, Meter(Role.ALLOCATOR))
    assert core.log[:6] == ["Plan", "Plan", "Plan", "prepared", "prepared", "nothing to do"]
    assert core.log[6:] == ["Tick"]  # then it sleeps


def test_an_event_that_comes_meanwhile_does_not_wait_for_the_rest(clock: _Clock) -> None:
    _, bus = network()
    stop = threading.Event()
    core = Provident(stop, to_do=1000, meanwhile=lambda: bus.publish(plan(1)))
    bus.publish(plan(0))
    serve(core, _Patient(bus, clock), stop, Meter(Role.ALLOCATOR))
    assert core.log[:5] == ["Plan", "prepared", "prepared", "Plan", "prepared"]


class _Patient:
    """A bus that waits for as long as it is told, as one on a network does."""

    def __init__(self, bus: LocalBus, clock: _Clock) -> None:
        self._bus, self._clock = bus, clock
        self.publish, self.refuse, self.close = bus.publish, bus.refuse, bus.close
        self.is_drained, self.has_paused = bus.is_drained, bus.has_paused

    def receive(self, timeout_s: float) -> Event | None:
        event = self._bus.receive(0.0)
        if event is None:
            self._clock.now_s += timeout_s
        return event


def test_a_process_that_was_away_while_it_handled_a_message_gets_no_tick(
    clock: _Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not before its bus has told the core what is no longer its own."""
    _, bus = network()
    stop, away = threading.Event(), [True, False]

    def answer(event: Event) -> Sequence[Message]:
        if isinstance(event, Plan):
            clock.now_s += 2.0 * TICK_S  # a tick is due when it is over
        elif isinstance(event, Tick):
            stop.set()
        return []

    def has_paused() -> bool:
        if not away.pop(0):
            return False
        bus.queue.append(Membership(Role.PLANNER, ()))
        return True

    monkeypatch.setattr(bus, "has_paused", has_paused)
    bus.publish(plan(0))
    core = Scripted(answer)
    serve(core, bus, stop, Meter(Role.ALLOCATOR))
    assert [type(event) for event in core.handled] == [Plan, Membership, Tick]
