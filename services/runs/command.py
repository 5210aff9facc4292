"""Commands to runs on services that are up. Any message may be lost, so one is sent until metrics shows it."""

import getpass
import json
import socket
import time
import uuid
from collections.abc import Callable, Sequence
from typing import Any

from pydantic import ValidationError

from cogradar.services.certs import own
from cogradar.services.delivery.order_book import commands_kept_free
from cogradar.services.errors import BadInput, NoMetrics, RunFailed
from cogradar.services.metrics.client import CONNECT_WITHIN_S
from cogradar.services.runs.cancel import ANSWER_WITHIN_S, POLL_S
from cogradar.shared.protocol.messages import Command
from cogradar.shared.protocol.orders import Action
from cogradar.shared.protocol.permissions import COMMANDER
from cogradar.shared.protocol.topics import Role
from cogradar.shared.protocol.words.orders import parsed
from cogradar.shared.scenario.faults import explain
from cogradar.shared.wire.queries import NoAnswer, ask
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus

WITHIN_S = 5.0
_COMMANDING = (Role.OPERATOR, COMMANDER)


def command_on(endpoint: str, run: str, words: Sequence[str], at: int = 0) -> dict[str, Any]:
    """Command a run on services that are up, in words. Raises as `order_on`, and BadInput if they are no action."""
    try:
        action = parsed(words)
    except ValueError as error:
        raise BadInput(str(error)) from None
    return order_on(endpoint, run, action, at)


def order_on(endpoint: str, run: str, action: Action, at: int = 0, asker: str = "") -> dict[str, Any]:
    """Command a run on services that are up; the row that `commands` has of it, granted.

    asker : for whom it is commanded, if not for oneself

    Raises NoMetrics if no metrics service answers, BadInput if there is no such run, it is over, the certificate is
    another role's, or the recorder refuses, RunFailed without a confirmation.
    """
    by = check_commander(endpoint) or _user()
    by = f"{by[: 94 - len(asker)]} for {asker}" if asker else by
    try:
        command = Command(run=run, id=uuid.uuid4().hex, by=by, action=action, at=at)
    except ValidationError as error:  # what is no name of a run
        raise BadInput(explain(error, Command)) from None
    try:
        session = open_session(endpoint.split(","), CONNECT_WITHIN_S, check=lambda: None)
    except ConnectionError as error:
        raise NoMetrics(f"no metrics service: {error}") from None
    bus = ZenohBus(session, Role.OPERATOR, own.operator_name(endpoint, _COMMANDING), reads=False)
    try:
        _check(session, command)
        row = _confirmed(session, lambda: bus.publish(command), command)
    except NoAnswer:
        raise NoMetrics(f"no metrics service answers at {endpoint}") from None
    finally:
        bus.close()
    if row["state"] == "refused":
        raise BadInput(f"{run}: refused: {row['reason']}")
    return row


def check_commander(endpoint: str) -> str:
    """The name on the certificate that is shown there; empty: none is. Raises BadInput if it may not command."""
    return own.check(endpoint, _COMMANDING)


def _check(session: Session, command: Command) -> None:
    """Raises BadInput if a run cannot be commanded, NoAnswer."""
    asked = {"run": command.run, "kept": str(commands_kept_free(command))}
    for row in json.loads(ask(session, "refusal", asked, ANSWER_WITHIN_S)):
        raise BadInput(row["reason"])


def _confirmed(session: Session, send: Callable[[], None], command: Command) -> dict[str, Any]:
    """The row of a command, which is sent until there is one. Raises BadInput, NoAnswer, RunFailed."""
    deadline, asked = time.monotonic() + WITHIN_S, {"run": command.run, "id": command.id}
    while time.monotonic() < deadline:
        send()
        time.sleep(POLL_S)
        try:
            rows: list[dict[str, Any]] = json.loads(ask(session, "command", asked, ANSWER_WITHIN_S))
        except NoAnswer:
            continue
        if rows:
            return rows[0]
    _check(session, command)
    raise RunFailed(
        f"no confirmation within {WITHIN_S:.0f} s that {command.run} is commanded: it may be, or the"
        " recorder hangs: `cogradar query commands` and `query runs` say it"
    )


def _user() -> str:
    """The name of the user, where no certificate says it."""
    try:
        name = getpass.getuser()
    except (KeyError, OSError):  # a user without a name, as in a container
        name = "somebody"
    told = f"{name}@{socket.gethostname()}"
    return "".join(one if " " <= one <= "~" else "?" for one in told)[:100]
