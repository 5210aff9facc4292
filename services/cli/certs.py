"""The command about certificates: an authority of one's own, and the clients that may be part of the system."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cogradar.services.cli.console import JsonOption, command, new_folder, out, print_json
from cogradar.services.errors import BadInput

FOLDER = "certs"
DAYS = {"init": 3650, "issue": 365}


class Action(StrEnum):
    """What is to be made."""

    INIT = "init"  # an authority
    ISSUE = "issue"  # certificates


def certs(
    action: Annotated[
        Action, typer.Argument(metavar="init|issue", show_choices=False, help="Make an authority, or certificates.")
    ],
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ROLE.NAME]...", help="With issue: one for each process, such as planner.host-1."),
    ] = None,
    folder: Annotated[
        str, typer.Option(metavar="FOLDER", callback=new_folder, help="Where authority and certificates are.")
    ] = FOLDER,
    hosts: Annotated[
        list[str] | None,
        typer.Option("--host", help="Name or address at which a router is reached. May repeat."),
    ] = None,
    days: Annotated[
        int | None,
        typer.Option(min=1, max=36500, help=f"How long it is valid; {DAYS['init']} of init, {DAYS['issue']} of issue."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a private authority, then a certificate for each process.

    `init` makes the authority: ca.key, which signs, belongs on no machine of
    the system. `issue` writes FOLDER/ROLE.NAME/zenoh.json5, which is all that
    a process needs (--zenoh-config), and adds the name to FOLDER/allowed, the
    router's list (--allow). ROLE is a role of the system, or observer, which
    reads and asks and sends nothing, or frontend, which answers the emulator.
    """
    from cogradar.services.certs import authority

    place = Path(folder)
    with command(at_once=True):
        if action is Action.INIT and (names or hosts):
            raise BadInput("init makes an authority: ROLE.NAME and --host belong to issue")
        if action is Action.ISSUE and not names:
            raise BadInput("issue: for whom? ROLE.NAME, such as planner.host-1")
        if action is Action.INIT:
            authority.create(place, days or DAYS["init"])
            written = [place / "ca.key", place / "ca.crt"]
        else:
            written = authority.issue(place, names or (), hosts or (), days or DAYS["issue"])
    if as_json:
        print_json([str(file) for file in written])
        return
    for file in written:
        out.print(str(file), soft_wrap=True)
