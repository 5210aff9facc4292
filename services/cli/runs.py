"""The commands about runs that services play without us: beginning one, cancelling one."""

from typing import Annotated

import typer

from services.cli.console import DEFAULT_ENDPOINT, ConnectOption, Stop, command, err, out, print_json
from shared.protocol.messages import RunStart


def cancel(
    run: Annotated[str, typer.Argument(help="Its name, as `cogradar query runs` shows it.")],
    connect: ConnectOption = DEFAULT_ENDPOINT,
) -> None:
    """End a run on services that are up before its time; its results so far stay in the store."""
    from services.runs import cancel as cancelling

    with command(at_once=True):
        cancelling.cancel_on(connect, run)
    out.print(f"{run} is cancelled", soft_wrap=True)


def start(run: RunStart, connect: str, stop: Stop, *, as_json: bool) -> None:
    """Begin a run, leave it to the services, and print its name."""
    from services.runs import cluster as distributed

    distributed.start_on(connect, run, say=lambda text: err.print(text, soft_wrap=True), stop=stop)
    if as_json:
        print_json({"run": run.run})
    else:
        out.print(run.run, soft_wrap=True)
