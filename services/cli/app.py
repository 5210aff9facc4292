"""The command line. Exit codes: 0 done, 1 failed, 2 bad input, 3 no metrics service, 130/143 interrupted."""

import re
import uuid
from contextlib import closing
from enum import StrEnum
from importlib.metadata import version
from typing import Annotated

import typer
from rich.console import Console

from services.cli import bench as cli_bench
from services.cli import runs as cli_runs
from services.cli import studies as cli_studies
from services.cli.console import (
    CONNECT_VARIABLE,
    DEFAULT_ENDPOINT,
    MAX_KILLS,
    ConnectOption,
    DwellsOption,
    FrontEndOption,
    JsonOption,
    ScenarioArgument,
    SharedServicesOption,
    Stop,
    command,
    err,
    out,
    print_csv,
    print_json,
    print_whole,
)
from services.errors import BadInput
from services.runs.run import Result, as_played, start_of
from services.topology import Start
from shared.protocol.messages import MAX_RATE_HZ, RunStart
from shared.protocol.topics import Role
from shared.scenario.files import SCENARIO_DIR, ScenarioError, load
from shared.scenario.radar_config import Strategy
from shared.scenario.scenario import Scenario


class Pace(StrEnum):
    """When the next dwell begins."""

    LOCKSTEP = "lockstep"  # as soon as its waveform is there; nothing is lost, and equal seeds give equal runs
    REALTIME = "realtime"  # when its time has come, whatever is missing


app = typer.Typer(
    name="cogradar",
    help="A distributed cognitive radar: POMCP planning and max-min power allocation in closed loop, over Zenoh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


def main() -> None:
    """Entry point."""
    app()


def _print_version(asked: bool) -> None:
    if asked:
        out.print(f"cogradar {version('cogradar')}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """What is said before a command."""


@app.command()
def run(
    scenario: ScenarioArgument,
    strategy: Annotated[Strategy, typer.Option(help="How the power is spread.")] = Strategy.POWER_AWARE,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Seed of the whole run.")] = 1,
    dwells: DwellsOption = None,
    planners: Annotated[int, typer.Option(min=1, max=64, help="Planner processes.")] = 1,
    in_process: Annotated[bool, typer.Option("--in-process", help="One process, no Zenoh.")] = False,
    store: Annotated[str | None, typer.Option(help="Keep the run in this SQLite file.")] = None,
    connect: SharedServicesOption = None,
    pace: Annotated[Pace, typer.Option(help="Dwell by dwell as fast as it goes, or by the clock.")] = Pace.LOCKSTEP,
    rate: Annotated[
        float | None,
        typer.Option(min=0.001, max=MAX_RATE_HZ, help="Dwells per second in real time; 1/dt_s if left out."),
    ] = None,
    chaos: Annotated[
        float | None, typer.Option(min=0.001, max=MAX_KILLS, help="Kill a process so many times a minute.")
    ] = None,
    detach: Annotated[
        bool, typer.Option("--detach", help="With --connect: begin the run, print its name, and leave it alone.")
    ] = False,
    front_end: FrontEndOption = Start.front_end,
    as_json: JsonOption = False,
) -> None:
    """Play one run, from acquisition to the table of results: on this machine, or on services that are up."""
    console = err if as_json else out
    with command() as stop:
        loaded = load(scenario)
        if connect and (in_process or store or planners != 1):
            given = f"--connect (or {CONNECT_VARIABLE})"
            raise BadInput(f"{given} uses services that are up: --in-process, --store and --planners do not apply")
        if in_process and (pace is Pace.REALTIME or chaos):
            raise BadInput("--in-process is one process in lockstep: --pace realtime and --chaos do not apply")
        if rate is not None and pace is Pace.LOCKSTEP:
            raise BadInput(f"--rate {rate:g}: applies to --pace realtime only")
        if detach and not connect:
            raise BadInput("--detach leaves a run to services that are up: it needs --connect")
        if chaos and connect:
            raise BadInput("--chaos kills processes that this command started: --connect does not apply")
        if connect and front_end != Start.front_end:
            raise BadInput("--front-end: services that are up have their own; `cogradar service emulator` is told it")
        if not connect:
            from services.front_ends import settled

            loaded, front_end = as_played(loaded, front_end), settled(front_end)
        rate_hz = 0.0 if pace is Pace.LOCKSTEP else rate or 1.0 / loaded.radar.motion.dt_s
        start = start_of(loaded, strategy, seed, dwells, rate_hz)
        if connect and detach:
            cli_runs.start(start, connect, stop, as_json=as_json)
            return
        if connect:
            result = _play_on(console, stop, start, connect)
        else:
            result = _play(console, stop, start, planners, in_process, store, chaos, front_end)
    if as_json:
        print_json(result.as_json())
    else:
        _print_result(result)


def _play_on(console: Console, stop: Stop, start: RunStart, endpoint: str) -> Result:
    from services.cli.display import RunDisplay
    from services.runs import cluster as distributed

    with RunDisplay(console, start.dwells) as display:
        return distributed.play_on(endpoint, start, report=display.report, say=display.say, stop=stop)


def _play(
    console: Console,
    stop: Stop,
    start: RunStart,
    planners: int,
    in_process: bool,
    store: str | None,
    chaos: float | None,
    front_end: str,
) -> Result:
    from services.metrics.store import Store
    from services.recorder.journal import Journal
    from services.recorder.schema import MEMORY

    kept = Journal(store or MEMORY, owner="cogradar run")  # a file that cannot be one, or is in use, is refused at once
    from services import kernels
    from services.cli.display import RunDisplay
    from services.runs import cluster as distributed
    from services.runs import in_process as local
    from services.runs.chaos import Chaos

    faults = Chaos(chaos, start.seed) if chaos else None
    with RunDisplay(console, start.dwells) as display:
        with closing(kept):
            kernels.compile_all(display.say, stop)
            if in_process:
                return local.play(
                    start,
                    planners=planners,
                    store=Store(kept),
                    report=display.report,
                    stop=stop,
                    front_end=front_end,
                )
        result = distributed.play(
            start,
            planners=planners,
            store=store,
            report=display.report,
            say=display.say,
            stop=stop,
            chaos=faults,
            front_end=front_end,
        )
        if faults:
            display.say(f"{faults.killed} processes were killed")
        return result


def _print_result(result: Result) -> None:
    from services.cli.display import run_caption, run_table

    for table in run_table(result):
        out.print(table)
    out.print(run_caption(result), soft_wrap=True)


@app.command()
def service(
    role: Annotated[Role, typer.Argument(help="Which process to be.")],
    connect: ConnectOption = DEFAULT_ENDPOINT,
    listen: Annotated[str, typer.Option(help="Where a router listens.")] = "tcp/0.0.0.0:7447",
    name: Annotated[str | None, typer.Option(help="Unique name of this process; made up if left out.")] = None,
    store: Annotated[str, typer.Option(help="SQLite file of recorder and metrics.")] = "cogradar.db",
    resume: Annotated[
        bool, typer.Option(help="Recorder: go on with the unfinished runs of its store, or give them up.")
    ] = True,
    keep_runs: Annotated[
        int | None,
        typer.Option(
            envvar="COGRADAR_KEEP_RUNS", min=0, help="Recorder: drop ended runs beyond so many; keep all if left out."
        ),
    ] = None,
    keep_days: Annotated[
        float | None,
        typer.Option(
            envvar="COGRADAR_KEEP_DAYS",
            min=0.0,
            help="Recorder: drop runs that ended longer ago, when another one ends.",
        ),
    ] = None,
    front_end: FrontEndOption = Start.front_end,
    scenario: Annotated[
        str, typer.Option(envvar="COGRADAR_SCENARIO", help="Operator: play this, seed after seed; empty: nothing.")
    ] = "",
    rate: Annotated[
        float,
        typer.Option(envvar="COGRADAR_RATE", min=0.001, max=MAX_RATE_HZ, help="Operator: dwells per second."),
    ] = 10.0,
    with_parent: Annotated[bool, typer.Option("--with-parent", hidden=True)] = False,
) -> None:
    """Be one process of the system until SIGTERM."""
    from services import process

    if name is not None and not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
        raise typer.BadParameter(f"{name!r}: letters, digits, '.', '_' and '-' only", param_hint="--name")
    with command() as stop:
        if with_parent:
            process.stop_with_parent(stop)
        played = load(scenario) if role is Role.OPERATOR and scenario else None
        start = Start(
            name or f"{role}-{uuid.uuid4().hex[:8]}",
            store,
            resume,
            keep_runs=keep_runs,
            keep_days=keep_days,
            front_end=front_end,
            scenario=played,
            rate_hz=rate,
        )
        process.be(role, start, connect=connect, listen=listen, stop=stop)


@app.command()
def query(
    metric: Annotated[str, typer.Argument(help="runs, tracks, p_d, rmse or summary.")],
    run_: Annotated[str | None, typer.Option("--run", help="Only this run.")] = None,
    target: Annotated[int | None, typer.Option(min=1, help="Only this target, counted from 1.")] = None,
    strategy: Annotated[Strategy | None, typer.Option(help="Only this strategy.")] = None,
    dwells: Annotated[str | None, typer.Option(help="First and last dwell, a:b.")] = None,
    connect: ConnectOption = DEFAULT_ENDPOINT,
    store: Annotated[str | None, typer.Option(help="Read this store file instead of asking a service.")] = None,
    as_json: JsonOption = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV only.")] = False,
) -> None:
    """Ask the metrics service, during a run or after it.

    Columns are called as in JSON, with their units; x, y and their estimates x_hat, y_hat are in km, vx, vy in km/s.

    The interval of p_d and summary is Wilson's, 95 %, over the dwells asked for as if they were independent. Dwells of
    one run are not: `cogradar campaign` and `report` give intervals over runs.
    """
    from services.cli.display import rows_table
    from services.metrics import client as asking

    given = {"run": run_, "target": target, "strategy": strategy and strategy.value, "dwells": dwells}
    parameters = {key: str(value) for key, value in given.items() if value is not None}
    with command(at_once=True):
        if as_json and as_csv:
            raise BadInput("--json and --csv: one of them")
        rows = asking.ask_store(store, metric, parameters) if store else asking.ask_service(connect, metric, parameters)
    if as_json:
        print_json(rows)
    elif as_csv:
        print_csv(rows)
    else:
        print_whole(rows_table(rows))


@app.command()
def scenarios(as_json: JsonOption = False) -> None:
    """List the built-in scenarios."""
    found = {path.stem: load(path.stem).title for path in sorted(SCENARIO_DIR.glob("*.toml"))}
    if as_json:
        print_json(found)
        return
    for name, title in found.items():
        out.print(f"{name:12} {title}")


@app.command()
def check(file: ScenarioArgument) -> None:
    """Validate a scenario file: say what it is, or all that is wrong with it."""
    with command(at_once=True):
        loaded = _loaded(file)
    radar = loaded.radar
    out.print(f"{file}: valid, {radar.tracks} targets, {loaded.dwells} dwells, {radar.fidelity}", soft_wrap=True)


def _loaded(file: str) -> Scenario:
    """A scenario; raises BadInput with a line for every fault."""
    try:
        return load(file)
    except ScenarioError as error:
        raise BadInput("\n".join(error.faults)) from None


for other in (
    cli_runs.cancel,
    cli_studies.campaign,
    cli_studies.report,
    cli_studies.figures,
    cli_studies.chaos,
    cli_bench.bench,
    cli_bench.verify,
):
    app.command()(other)


if __name__ == "__main__":
    main()
