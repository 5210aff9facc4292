"""The commands about runs that services play without us: beginning one, cancelling one."""

from typing import Annotated

import typer

from services.cli.console import (
    DEFAULT_ENDPOINT,
    NO_METRICS,
    ConnectOption,
    Stop,
    end,
    err,
    failures_reported,
    out,
    print_json,
    stop_on_signals,
)
from shared.protocol.messages import RunStart


def cancel(
    run: Annotated[str, typer.Argument(help="Its name, as `cogradar query runs` shows it.")],
    connect: ConnectOption = DEFAULT_ENDPOINT,
) -> None:
    """End a run on services that are up before its time; its results so far stay in the store."""
    from services.metrics import client as asking
    from services.runs import cancel as cancelling

    with failures_reported(stop_on_signals(at_once=True), bad_input=(cancelling.NotRunning,)):
        try:
            cancelling.cancel_on(connect, run)
        except asking.NoMetrics as error:
            end(error, NO_METRICS)
    out.print(f"{run} is cancelled", soft_wrap=True)


def start(run: RunStart, connect: str, stop: Stop, *, as_json: bool) -> None:
    """Begin a run, leave it to the services, and print its name."""
    from services.runs import cluster as distributed

    with failures_reported(stop):
        distributed.start_on(connect, run, say=lambda text: err.print(text, soft_wrap=True), stop=stop)
    if as_json:
        print_json({"run": run.run})
    else:
        out.print(run.run, soft_wrap=True)
