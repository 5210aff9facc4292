"""When the recorder asks again for what a dwell lacks."""

FIRST, LAST = 2, 32  # ticks in which nothing of a dwell comes; at least, and at most
SHARED = 8  # at least, while other runs go on: it may only wait for its turn
SLOW = 3  # times what a dwell took


class RetransmitTimer:
    """Of one run. As in TCP it waits longer where dwells take long, and twice as long after each request: a request
    would slow down a process that is only slow.
    """

    def __init__(self, first: int = FIRST) -> None:
        self.was_asked = False  # for something of this dwell
        self._first = self.wait = first  # ticks until it asks for something of a dwell; until the next request
        self._waited = 0  # ... since something of it came, or was asked for
        self._took = 0  # ... since it began, or something of it was asked for
        self._longest = 0  # wait that followed a request

    def tick(self) -> None:
        """A tick has passed."""
        self._waited += 1
        self._took += 1

    def is_over(self, *, is_shared: bool) -> bool:
        """Whether to ask; `is_shared`: others go on."""
        return self._waited >= max(self.wait, SHARED if is_shared else 0)

    def ask(self) -> None:
        """It asks."""
        self.was_asked = True
        self._waited = self._took = 0
        self.wait = max(self.wait, min(2 * self.wait, LAST))
        self._longest = max(self._longest, self.wait)

    def hear(self) -> None:
        """Something of the dwell has come."""
        self._waited, self.wait = 0, self._first

    def learn(self) -> None:
        """The dwell is complete.

        What comes soon after a request was lost, and its sender is not slow; the later it comes, the less can be said.
        More than two requests in a row were rather in vain. A process that was slow a dwell ago may be so again.
        """
        half = self._first // 2
        wait = max(SLOW * self._took + half * self.was_asked, half, self._longest // 4)
        self._first = min(max(FIRST, wait), LAST)
        self._waited, self.wait, self._took, self._longest, self.was_asked = 0, self._first, 0, 0, False
