"""The tasks of a run that go on: begun, stopped and ended by commands, which are granted while the feed goes on."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

from cogradar.services.errors import BadInput, Failure
from cogradar.services.feed.picture import Picture, Track
from cogradar.services.feed.sapient.tasks import Wanted, undone, wanted_of
from cogradar.services.runs.command import check_commander, order_on
from cogradar.shared.protocol.orders import Action, EndRun, Order, Pause, in_force
from cogradar.shared.protocol.words.orders import text_of

MAX_TASKS = 32  # that go on at a time; a run has room for 48 orders of its commanders
MAX_REASON = 300  # characters
START, STOP = 1, 2  # what a task is to be done with
ACCEPTED, REJECTED, COMPLETED, FAILED = 1, 2, 3, 4  # states of a task
NO_TASKS = "this feed takes no tasks: start it with --tasks, or use `cogradar command`"


class Asked(NamedTuple):
    """A command to a run."""

    run: str
    action: Action
    at: int  # not before this dwell
    asker: str


Command = Callable[[Asked], "Future[dict[str, Any]]"]  # the row that `commands` has of it, granted, or a Failure


class Commander:
    """Commands runs on services that are up, one after the other. Nothing of a feed waits for it."""

    def __init__(self, endpoint: str) -> None:
        """Raises BadInput if the certificate is no commander's."""
        check_commander(endpoint)
        self._endpoint = endpoint
        self._pool = ThreadPoolExecutor(1, "commander")

    def __call__(self, asked: Asked) -> "Future[dict[str, Any]]":
        """Have a run commanded."""
        return self._pool.submit(order_on, self._endpoint, asked.run, asked.action, asked.at, asked.asker)

    def close(self) -> None:
        """Wait for the command that is under way; those behind it are not sent."""
        self._pool.shutdown(cancel_futures=True)


class Ack(NamedTuple):
    """What has become of a task, for the node that sent it."""

    node: str
    task: str
    status: int
    reason: str


@dataclass
class _Task:
    said: bytes  # as it was sent
    node: str  # that sent it, or the order to stop it
    run: str
    wanted: Wanted
    until_s: float  # UTC, from which on it is to be undone
    asked: "Future[dict[str, Any]] | None"  # a command under way: to begin the task, or to undo it
    k: int | None = None  # first dwell under its order; None: it is not granted yet
    is_paused: bool = False  # transmission, since this task asked for it

    @property
    def over_k(self) -> float:
        """Dwell with which the task is over if nothing undoes it."""
        if self.k is None:
            return math.inf
        dwells: int | None = getattr(self.wanted.action, "dwells", None)
        if dwells is None:  # it lasts, or it is done with its first dwell
            return self.k if undone(self.wanted.action) is None else math.inf
        return self.k + dwells


class Tasking:
    """Tasks in, acknowledgements out: some at once, others with a later picture."""

    def __init__(self, command: Command | None) -> None:
        """command : sends a command of a task; None: no task is taken."""
        self._command = command
        self._tasks: dict[str, _Task] = {}  # that go on, by identifier

    @property
    def most(self) -> int:
        """Tasks that may go on at a time."""
        return 0 if self._command is None else MAX_TASKS

    @property
    def active(self) -> str:
        """The newest task whose order is granted; empty: there is none."""
        return next((name for name, task in reversed(self._tasks.items()) if task.k is not None), "")

    def take(self, node: str, task: Any, picture: Picture, shown: Mapping[str, Track]) -> Ack | None:
        """Begin or stop a task; what can be said of that at once.

        picture : the newest one; shown : its tracks by object
        """
        try:
            if self._command is None:
                raise ValueError(NO_TASKS)
            if picture.is_last:
                raise ValueError("the radar has said goodbye")
            if task.control == STOP:
                return self._stop(node, task.task_id)
            if task.control != START:
                raise ValueError("control: must be start or stop; a task cannot be paused")
            return self._start(self._command, node, task, picture, shown)
        except ValueError as error:
            return _ack(node, task.task_id, REJECTED, str(error))

    def due(self, picture: Picture, shown: Mapping[str, Track]) -> list[Ack]:
        """What has become of tasks by this picture; those whose time is over are undone."""
        replaced = self._replaced(picture)
        found = [
            self._over(name, COMPLETED, "a later task or command has replaced it")
            if name in replaced
            else self._advanced(name, task, picture, shown)
            for name, task in list(self._tasks.items())
        ]
        return [ack for ack in found if ack is not None]

    def _replaced(self, picture: Picture) -> set[str]:
        """Tasks whose orders no longer shape this dwell, although nothing has undone them."""
        there = {name: task for name, task in self._tasks.items() if task.run == picture.run and task.asked is None}
        begun = {name: task for name, task in there.items() if task.k is not None and task.k <= picture.k}
        orders = [Order(n=n, k=task.k or 0, action=task.wanted.action) for n, task in enumerate(begun.values(), 1)]
        left = {order.n for order in in_force(orders, picture.k)}
        found = set[str]()
        for n, (name, task) in enumerate(begun.items(), 1):
            if isinstance(task.wanted.action, Pause):
                is_ended = task.is_paused and not picture.is_paused  # by a command of somebody else
                task.is_paused = picture.is_paused
            else:
                is_ended = False
            if is_ended or (n not in left and undone(task.wanted.action) is not None):
                found.add(name)
        return found

    def _start(
        self, command: Command, node: str, task: Any, picture: Picture, shown: Mapping[str, Track]
    ) -> Ack | None:
        """Have a task begun; one that goes on, and is sent again, is acknowledged again."""
        said = task.SerializeToString(deterministic=True)
        if (known := self._tasks.get(task.task_id)) is not None:
            if said != known.said:
                raise ValueError("another task of this identifier goes on: stop it, or take another identifier")
            if known.k is None:
                return None  # its answer is under way
            return _ack(node, task.task_id, ACCEPTED, f"{text_of(known.wanted.action)} from dwell {known.k} on")
        if len(self._tasks) >= MAX_TASKS:
            raise ValueError(f"{MAX_TASKS} tasks go on, which is the most: stop one")
        wanted = wanted_of(task, picture, shown)
        asked = command(Asked(picture.run, wanted.action, wanted.at, _asker(node)))
        self._tasks[task.task_id] = _Task(said, node, picture.run, wanted, wanted.until_s, asked)
        return None

    def _stop(self, node: str, name: str) -> Ack | None:
        if (task := self._tasks.get(name)) is None:
            raise ValueError("no task of this identifier goes on")
        if undone(task.wanted.action) is None:
            raise ValueError(f"nothing takes back `{text_of(task.wanted.action)}`")
        task.node, task.until_s = node, -math.inf
        return None

    def _advanced(self, name: str, task: _Task, picture: Picture, shown: Mapping[str, Track]) -> Ack | None:
        """What there is to be said of a task that goes on."""
        if picture.is_last or picture.run != task.run:
            status = COMPLETED if isinstance(task.wanted.action, EndRun) else FAILED
            return self._over(name, status, "the run or its feed has ended; in a run that goes on the order stays")
        if task.asked is not None:
            return self._answered(name, task, task.asked) if task.asked.done() else None
        if task.over_k <= picture.k:
            return self._over(name, COMPLETED, f"{text_of(task.wanted.action)}: done with dwell {task.over_k:.0f}")
        if task.wanted.follows and task.wanted.follows not in shown:
            return self._over(name, COMPLETED, "the track has ended, and what was ordered with it")
        action = undone(task.wanted.action)
        if task.until_s <= picture.utc_s and action is not None and self._command is not None:
            at = task.k if task.k is not None and task.k > picture.k else 0  # not before what is to be undone
            task.asked = self._command(Asked(task.run, action, at, _asker(task.node)))
        return None

    def _answered(self, name: str, task: _Task, asked: "Future[dict[str, Any]]") -> Ack | None:
        task.asked = None
        try:
            row = asked.result()
        except (Failure, OSError) as error:
            is_refused = isinstance(error, BadInput)
            if task.k is None or is_refused:
                return self._over(name, REJECTED if task.k is None and is_refused else FAILED, str(error))
            task.until_s = math.inf
            return _ack(task.node, name, FAILED, f"it goes on, and may be stopped again: {error}")
        said = f"{row['action']} from dwell {row['k']} on"
        if task.k is not None:
            return self._over(name, COMPLETED, said)
        task.k = row["k"]
        return _ack(task.node, name, ACCEPTED, said)

    def _over(self, name: str, status: int, reason: str) -> Ack:
        return _ack(self._tasks.pop(name).node, name, status, reason)


def _ack(node: str, task: str, status: int, reason: str) -> Ack:
    return Ack(node, task, status, reason[:MAX_REASON])


def _asker(node: str) -> str:
    """The node, as the list of commands may show it."""
    return "SAPIENT " + "".join(one if " " <= one <= "~" else "?" for one in node[:40])
