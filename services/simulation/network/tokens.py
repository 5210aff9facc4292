"""Liveliness tokens in simulated time: each process of a pool sees what the others show, unless a fault hides it."""

from collections import deque
from collections.abc import Callable
from functools import partial

from cogradar.services.simulation.network.links import LIVELINESS, Links
from cogradar.services.simulation.process import Clock
from cogradar.services.simulation.schedule import Fault, Kind
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.pool.members import Token
from cogradar.shared.wire.pool.tokens import AGAIN_S

RETURN_S = 2.8  # within which processes are back at a router that was restarted, one after the other
TOGETHER_S = 4.0  # after which processes that see each other again do not serve one shard any more
SINCE_NS = 10**18  # time of day at the beginning
SKEWED_S = 10  # most that a process's clock is wrong


class SeenTokens:
    """The tokens that one process shows and sees: `Tokens` of `cogradar.shared.wire.pool.members`."""

    def __init__(self, space: "TokenSpace", key: str, name: str, clock: Clock) -> None:
        self.arrived: deque[tuple[Token, bool]] = deque()
        self.answers: deque[tuple[float, set[Token]]] = deque(maxlen=1)
        self.n_lost = 0
        self.key, self.name = key, name
        self.shown: set[Token] = set()
        self.noted = set[Token]()  # what word was sent of
        self.is_asleep = self.is_out = False  # its process is frozen and its lease over; it has no router
        self._space, self._clock = space, clock

    @property
    def is_linked(self) -> bool:
        """Whether it has a connection to a router."""
        return not (self.is_asleep or self.is_out)

    def now_s(self) -> float:
        """Its process's clock."""
        return self._clock.read(self._space.now())

    def cpu_s(self) -> float:
        """To compute takes no simulated time."""
        return 0.0

    def moment(self) -> str:
        """The time of day, as wrong as its clock."""
        return self._space.moment()

    def wait(self, seconds: float) -> None:
        """What the transport has to tell is known at once."""

    def watch(self) -> None:
        """From now on it hears of tokens, and asks for all of them every AGAIN_S."""
        self._space.join(self)

    def there(self) -> set[Token]:
        """All tokens that it sees now."""
        return self._space.seen_by(self)

    def routers(self) -> frozenset[str]:
        """The router, which is another one after a restart."""
        return frozenset({str(self._space.n_router)} if self.is_linked else ())

    def show(self, shard: str, moment: str) -> Callable[[], None]:
        """Show a token; the answer withdraws it."""
        token = Token(shard, moment, self.name)
        self.shown.add(token)
        self._space.tell()
        return partial(self._withdraw, token)

    def _withdraw(self, token: Token) -> None:
        self.shown.discard(token)
        self._space.tell()

    def close(self) -> None:
        """Nothing is to be closed."""


class TokenSpace:
    """All tokens of the pools, and which process sees which."""

    def __init__(self, at: Callable[[float, Callable[[], None]], None], now: Callable[[], float], links: Links) -> None:
        self.now, self.n_router = now, 0
        self._at, self._links = at, links
        self._members: dict[str, SeenTokens] = {}  # by key of the process
        self._deaf: set[Fault] = set()
        self._n_moment = 0
        self._is_divided = False  # a process has joined that does not see those without a router
        self._is_disturbed, self._disturbed_s = False, -TOGETHER_S  # whether some do not see each other, and when last

    def moment(self) -> str:
        """A time of day by the clock of a process that starts now."""
        self._n_moment += 1
        skewed_s = self.now() + (self._n_moment * 7919) % (2 * SKEWED_S + 1) - SKEWED_S
        return f"{SINCE_NS + int(skewed_s * 1e9):020d}-{self._n_moment:08x}"

    def join(self, member: SeenTokens) -> None:
        """A process is there from now on."""
        self._is_divided = self._is_divided or any(one.is_out for one in self._members.values())
        self._members[member.key] = member
        self._look_again(member)
        self.tell()

    def leave(self, key: str) -> None:
        """A process is gone, and its tokens with it."""
        if self._members.pop(key, None) is not None:
            self.tell()

    def freeze(self, key: str, *, is_asleep: bool) -> None:
        """The lease of a frozen process is over, or it is awake again, and connects anew."""
        member = self._members.get(key)
        if member is not None and member.is_asleep != is_asleep:
            member.is_asleep, member.n_lost = is_asleep, member.n_lost + is_asleep
            self.tell()

    def begin(self, fault: Fault) -> None:
        """A fault of the router, or word of tokens that does not arrive."""
        if fault.kind is Kind.UNHEARD:
            self._deaf.add(fault)
        elif fault.kind is Kind.ROUTER:
            for member in self._members.values():
                member.is_out, member.n_lost = True, member.n_lost + 1
        self.tell()

    def end(self, fault: Fault) -> None:
        """It is over; processes come back to the router one after the other."""
        self._deaf.discard(fault)
        if fault.kind is Kind.ROUTER:
            self.n_router += 1
            members = list(self._members.values())
            for i, member in enumerate(members):
                self._at(self.now() + RETURN_S * (i + 1) / len(members), partial(self._return, member))
        self.tell()

    def is_whole(self) -> bool:
        """Whether all processes have seen each other for long enough for their claims to be settled.

        Without a router none sees any other, and each waits for it: no claim moves because of that.
        """
        return not self._is_disturbed and self.now() >= self._disturbed_s + TOGETHER_S

    def seen_by(self, reader: SeenTokens) -> set[Token]:
        """The tokens that a process sees now, its own included."""
        if not reader.is_linked:
            return set()
        return {token for one in self._members.values() if self._sees(reader, one) for token in one.shown}

    def tell(self) -> None:
        """Send word of what has changed."""
        self._is_divided = self._is_divided and any(one.is_out for one in self._members.values())
        before = self._is_disturbed
        self._is_disturbed = bool(self._deaf) or self._is_divided or self._is_cut()
        if before or self._is_disturbed:
            self._disturbed_s = self.now()
        for reader in self._members.values():
            seen = self.seen_by(reader)
            for token, is_there in [(one, one in seen) for one in sorted(seen ^ reader.noted)]:
                for at_s in self._links.arrivals(LIVELINESS, reader.name, self.now()):
                    self._at(at_s, partial(self._arrive, reader, token, is_there))
            reader.noted = seen

    def _arrive(self, reader: SeenTokens, token: Token, is_there: bool) -> None:
        if not any(reader.key.startswith(fault.who) for fault in self._deaf):
            reader.arrived.append((token, is_there))

    def _return(self, member: SeenTokens) -> None:
        member.is_out = False
        self.tell()

    def _look_again(self, member: SeenTokens) -> None:
        if self._members.get(member.key) is not member:
            return
        if not member.is_asleep:
            member.answers.append((member.now_s(), self.seen_by(member)))
        self._at(self.now() + AGAIN_S, partial(self._look_again, member))

    def _sees(self, reader: SeenTokens, one: SeenTokens) -> bool:
        if one is reader:
            return True
        is_same_role = Role(one.key.split("-")[0]) is Role(reader.key.split("-")[0])
        return is_same_role and one.is_linked and not self._links.is_cut(one.name, reader.name)

    def _is_cut(self) -> bool:
        names = [member.name for member in self._members.values()]
        return any(self._links.is_cut(one, other) for one in names for other in names if one != other)
