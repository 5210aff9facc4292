"""Whether a service is up, for health checks: python -m services.health ROLE [NAME]. Exit code 0 or 1, one line why.

A service is up when the router that COGRADAR_CONNECT names shows its liveliness token; metrics must answer, too.
"""

import os
import socket
import sys

from shared.protocol.topics import ALIVE, PROTOCOL, Role
from shared.wire.queries import NoAnswer, ask
from shared.wire.session import Session, open_session

WITHIN_S = 3.0
ROUTER_HERE = "tcp/127.0.0.1:7447"


def fault(role: Role, name: str, endpoints: str) -> str | None:
    """What is wrong with a service, or None."""
    try:
        session = open_session(endpoints.split(","), WITHIN_S, check=lambda: None)
    except ConnectionError as error:
        return str(error)
    try:
        if role is Role.ROUTER:
            return None  # the session is open: the router answered
        silent = _does_not_answer(session) if role is Role.METRICS else None
        return silent or _shows_no_token(session, ALIVE.format(protocol=PROTOCOL, build="*", role=role, name=name))
    finally:
        session.close()


def _shows_no_token(session: Session, token: str) -> str | None:
    replies = session.liveliness().get(token, timeout=WITHIN_S)
    return None if any(reply.ok is not None for reply in replies) else f"the router does not see {token}"


def _does_not_answer(session: Session) -> str | None:
    try:
        ask(session, "runs", {"run": "-"}, timeout_s=WITHIN_S)  # a run that there is not: a short answer
    except NoAnswer as error:
        return str(error)
    return None


def main() -> int:
    """Entry point."""
    if len(sys.argv) not in (2, 3) or sys.argv[1] not in set(Role):
        sys.stderr.write("usage: python -m services.health ROLE [NAME]\n")
        return 2
    role = Role(sys.argv[1])
    # In a container a service is called after its role and the container: deploy/container/entrypoint.sh
    name = sys.argv[2] if len(sys.argv) == 3 else f"{role}-{socket.gethostname()}"
    found = fault(role, name, os.environ.get("COGRADAR_CONNECT") or ROUTER_HERE)
    if found:
        sys.stderr.write(f"{name}: {found}\n")
    return int(found is not None)


if __name__ == "__main__":
    sys.exit(main())
