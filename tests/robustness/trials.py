"""A core in mid-run is sent mutants on the ordinary path, and then hears the rest of its run."""

import time
from collections import Counter
from dataclasses import dataclass, field

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.slots import ALL_SLOTS
from cogradar.shared.protocol.topics import TOPICS, Role, Topic
from cogradar.shared.wire.bus import LOCAL, MAX_BAD_KEYS, LocalNetwork
from cogradar.shared.wire.codec import BadMessage, decode, encode
from cogradar.shared.wire.runner import handle
from tests.robustness.heard import ROLES, Replayed, Run
from tests.robustness.mutants import mutant

AT_ONCE = 100  # mutants in one run


@dataclass
class Fates:
    """What became of mutants."""

    counts: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0  # that one message took


class _Readers(LocalNetwork):
    """Where a core's answers go. They must be messages, whatever it was told."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[bytes] = []

    def deliver(self, message: Message, _slots: str = ALL_SLOTS) -> None:
        payload = encode(message)
        decode(payload)
        self.heard.append(payload)


class _Station:
    """A core in mid-run, on its bus."""

    def __init__(self, run: Run, role: Role, at: int) -> None:
        self.network = _Readers()
        self.bus = self.network.endpoint(role, run.heard[role][0])
        self._rest = run.heard[role][1][at:]
        self.replayed: Replayed = run.core(role, at)

    @property
    def n_bad(self) -> int:
        """Messages dropped or refused, each counted under a name."""
        return self.bus.inbox.bad.total()

    def take(self, message: Message) -> bool:
        """Whether a message is taken; it is refused and counted otherwise."""
        before = self.n_bad
        handle(self.replayed.core, self.bus, message)
        self.replayed.validate()
        return self.n_bad == before

    def go_on(self) -> list[bytes]:
        """What it sends while it hears the rest of its run."""
        self.network.heard.clear()
        for now_s, event in self._rest:
            self.replayed.now_s = now_s
            handle(self.replayed.core, self.bus, event)
            self.replayed.validate()
        return self.network.heard


def play(run: Run, topic: Topic, role: Role, seed: int, fates: Fates, n: int = AT_ONCE) -> None:
    """Send mutants to a core in mid-run. Whatever else than Refused comes out of it is raised.

    Two cores hear the same. One takes whatever it takes, and must go on; the other is sent only what that one refuses,
    so that it must be as it was, unless it takes one of them.
    """
    rng = generator(seed, Purpose.FAULT, TOPICS.index(topic), ROLES.index(role))
    at = int(rng.integers(1, len(run.heard[role][1])))
    taking, clean, is_clean = _Station(run, role, at), _Station(run, role, at), True
    key = topic.key_of(decode(run.said[topic.name][0]), LOCAL)
    for _ in range(n):
        payload = mutant(rng, run.said[topic.name])
        try:
            message = decode(payload)
        except BadMessage:
            assert taking.bus.inbox.open(key, payload) == []
            fates.counts["dropped"] += 1
            continue
        if type(message) not in taking.bus.reads:
            continue  # it went to others
        began = time.perf_counter()
        is_taken = taking.take(message)
        fates.slowest_s = max(fates.slowest_s, time.perf_counter() - began)
        fates.counts["taken" if is_taken else "refused"] += 1
        if not is_taken and is_clean:
            is_clean = not clean.take(message)
    assert taking.n_bad <= n
    assert len(taking.bus.inbox.bad) <= MAX_BAD_KEYS + 1
    taking.go_on()
    if is_clean:
        fates.counts["unchanged"] += 1
        undisturbed = _Station(run, role, at)
        assert clean.go_on() == undisturbed.go_on()
        undisturbed.replayed.close()
    taking.replayed.close()
    clean.replayed.close()
