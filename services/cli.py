"""The command line. Exit codes: 0 done, 1 failed, 2 bad input, 3 no metrics service, 130/143 interrupted."""

import json
import re
import sys
import threading
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console

from services.runs import Interrupted, Result, RunFailed, start_of
from shared.messages import RunStart
from shared.scenario import SCENARIO_DIR, Scenario, ScenarioError, Strategy, load
from shared.topics import Role

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
FAILED, BAD_INPUT, NO_METRICS = 1, 2, 3

app = typer.Typer(
    name="cogradar",
    help="A distributed cognitive radar: POMCP planning and max-min power allocation in closed loop, over Zenoh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
out = Console()
err = Console(stderr=True)

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON only.")]
CONNECT_VARIABLE = "COGRADAR_CONNECT"
ConnectOption = Annotated[str, typer.Option(envvar=CONNECT_VARIABLE, help="Endpoint of a Zenoh router.")]


def main() -> None:
    """Entry point."""
    app()


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="Name of a built-in scenario, or a TOML file.")],
    strategy: Annotated[Strategy, typer.Option(help="How the power is spread.")] = Strategy.POWER_AWARE,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Seed of the whole run.")] = 1,
    dwells: Annotated[int | None, typer.Option(min=1, max=1_000_000, help="Instead of the scenario's number.")] = None,
    planners: Annotated[int, typer.Option(min=1, max=64, help="Planner processes.")] = 1,
    in_process: Annotated[bool, typer.Option("--in-process", help="One process, no Zenoh.")] = False,
    store: Annotated[str | None, typer.Option(help="Keep the run in this SQLite file.")] = None,
    connect: Annotated[
        str | None, typer.Option(envvar=CONNECT_VARIABLE, help="Use the services behind this router; start none.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Play one run, from acquisition to the table of results: on this machine, or on services that are up."""
    loaded = _load(scenario)
    if connect and (in_process or store or planners != 1):
        _bad_input(ValueError("--connect uses services that are up: --in-process, --store and --planners do not apply"))
    stop = _stop_on_signals()
    try:
        result = _play(
            err if as_json else out,
            stop,
            start_of(loaded, strategy, seed, dwells),
            planners,
            in_process,
            store,
            connect,
        )
    except Interrupted as error:
        err.print(str(error))
        raise typer.Exit(stop.exit_code) from None
    except _failures() as error:
        err.print(str(error), style="red", highlight=False, markup=False, soft_wrap=True)
        raise typer.Exit(FAILED) from None
    if as_json:
        sys.stdout.write(json.dumps(result.as_json()) + "\n")
    else:
        _print_result(result)


@app.command()
def campaign(
    scenario: Annotated[str, typer.Argument(help="Name of a built-in scenario, or a TOML file.")],
    store: Annotated[str, typer.Option(help="SQLite file of the results.")],
    runs: Annotated[int, typer.Option(min=1, max=1_000_000, help="Runs per strategy.")] = 100,
    strategies: Annotated[str, typer.Option(help="Comma-separated.")] = ",".join(Strategy),
    seed: Annotated[int, typer.Option(min=0, max=10**9, help="Seed of the first run; the others follow.")] = 1,
    dwells: Annotated[int | None, typer.Option(min=1, max=1_000_000, help="Instead of the scenario's number.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, max=1024, help="Processes; one per core if left out.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what the store has.")] = False,
    connect: Annotated[
        str | None,
        typer.Option(help="Use the services behind this router; --workers is then the runs at once, two per planner."),
    ] = None,
) -> None:
    """Play many runs on all cores, same seeds for every strategy; `cogradar report` says what came out."""
    from services import campaign as campaigns
    from services import campaign_connected, kernels
    from services.display import CampaignDisplay, campaign_caption

    loaded = _load(scenario)
    try:
        asked = campaigns.Campaign(loaded, campaigns.parse_strategies(strategies), runs, seed, dwells or loaded.dwells)
        kept = campaigns.open_store(store, asked, resume=resume)
    except campaigns.BadCampaign as error:
        _bad_input(error)
    except _failures() as error:
        _fail(error)
    stop = _stop_on_signals()
    try:
        with CampaignDisplay(out) as display:
            if connect:
                tally = campaign_connected.play(
                    asked, kept, connect, workers, report=display.report, say=display.say, stop=stop
                )
            else:
                kernels.compile_all(display.say)
                n_worker = workers or campaigns.n_core()
                tally = campaigns.play(asked, kept, n_worker, report=display.report, say=display.say, stop=stop)
        out.print(campaign_caption(tally, campaigns.results_digest(kept)), highlight=False, soft_wrap=True)
    except Interrupted as error:
        err.print(str(error), highlight=False)
        raise typer.Exit(stop.exit_code) from None
    except _failures() as error:
        _fail(error)


@app.command()
def report(
    store: Annotated[str, typer.Argument(help="SQLite file of a campaign, or of other complete runs.")],
    into: Annotated[
        str | None, typer.Option(help="Markdown file whose tables to rewrite, between its markers.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what the runs of a store show: detection, errors, lost tracks, strategies compared, all with intervals."""
    from services import asking, report_tables
    from services.answers import BadQuery
    from services.report import BadReport
    from services.report import report as report_on

    try:
        found = report_on(asking.open_store(store))
        if into:
            report_tables.write_into(Path(into), found)
    except (BadQuery, BadReport) as error:
        _bad_input(error)
    if as_json:
        sys.stdout.write(json.dumps(found) + "\n")
        return
    for table in report_tables.rich_tables(report_tables.sheets(found, in_time=True)):
        out.print(table)
    out.print(report_tables.caption(found), highlight=False, soft_wrap=True)


@app.command()
def service(
    role: Annotated[Role, typer.Argument(help="Which process to be.")],
    connect: ConnectOption = DEFAULT_ENDPOINT,
    listen: Annotated[str, typer.Option(help="Where a router listens.")] = "tcp/0.0.0.0:7447",
    name: Annotated[str | None, typer.Option(help="Unique name of this process; made up if left out.")] = None,
    store: Annotated[str, typer.Option(help="SQLite file of metrics.")] = "cogradar.db",
    resume: Annotated[
        bool, typer.Option("--resume", help="Metrics: go on with the runs that the store holds unfinished.")
    ] = False,
    with_parent: Annotated[bool, typer.Option("--with-parent", hidden=True)] = False,
) -> None:
    """Be one process of the system until SIGTERM."""
    from services import process

    if name is not None and not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
        raise typer.BadParameter(f"{name!r}: letters, digits, '.', '_' and '-' only", param_hint="--name")
    if role not in process.STARTABLE:
        raise typer.BadParameter(f"{role.value}: must be one of {', '.join(process.STARTABLE)}", param_hint="ROLE")
    stop = _stop_on_signals()
    if with_parent:
        process.stop_with_parent(stop)
    try:
        process.be(role, name, connect=connect, listen=listen, store=store, resume=resume, stop=stop)
    except _failures() as error:
        err.print(str(error), style="red", highlight=False, markup=False)
        raise typer.Exit(FAILED) from None


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
) -> None:
    """Ask the metrics service, during a run or after it."""
    from services import asking
    from services.answers import BadQuery
    from services.display import rows_table

    given = {"run": run_, "target": target, "strategy": strategy and strategy.value, "dwells": dwells}
    parameters = {key: str(value) for key, value in given.items() if value is not None}
    try:
        rows = asking.ask_store(store, metric, parameters) if store else asking.ask_service(connect, metric, parameters)
    except BadQuery as error:
        _bad_input(error)
    except asking.NoMetrics as error:
        err.print(str(error), style="red", highlight=False, markup=False)
        raise typer.Exit(NO_METRICS) from None
    if as_json:
        sys.stdout.write(json.dumps(rows) + "\n")
    else:
        out.print(rows_table(rows))


@app.command()
def scenarios(as_json: JsonOption = False) -> None:
    """List the built-in scenarios."""
    found = {path.stem: load(path.stem).title for path in sorted(SCENARIO_DIR.glob("*.toml"))}
    if as_json:
        sys.stdout.write(json.dumps(found) + "\n")
        return
    for name, title in found.items():
        out.print(f"{name:12} {title}", highlight=False)


@app.command()
def check(file: Annotated[str, typer.Argument(help="Name of a built-in scenario, or a TOML file.")]) -> None:
    """Validate a scenario file."""
    loaded = _load(file)
    out.print(
        f"{file}: valid, {loaded.n_target} targets, {loaded.dwells} dwells, {loaded.fidelity}",
        highlight=False,
        markup=False,
    )


@app.command()
def bench(
    cases: Annotated[
        list[str] | None,
        typer.Argument(metavar="[CASE]...", help="Only these cases; `scale`: what being distributed costs."),
    ] = None,
    into: Annotated[
        str | None, typer.Option(help="With `scale`: Markdown page whose tables to rewrite, between its markers.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Time the kernels and a whole dwell: medians of many repeats, beside the goals."""
    from services import bench as benchmark
    from services import kernels

    if cases == ["scale"]:
        _bench_scale(into, as_json=as_json)
        return
    if into:
        _bad_input(ValueError("--into belongs to `bench scale`"))
    if unknown := set(cases or ()) - set(benchmark.CASES):
        _bad_input(ValueError(f"{min(unknown)}: no such case, must be one of {', '.join(benchmark.CASES)}"))
    console = err if as_json else out
    kernels.compile_all(console.print)
    with console.status("") as status:
        try:
            report = benchmark.bench(cases or (), status.update)
        except _failures() as error:
            _fail(error)
    if as_json:
        sys.stdout.write(json.dumps(report.as_json()) + "\n")
        return
    out.print(benchmark.bench_table(report))
    for line in benchmark.remarks(report):
        out.print(line, highlight=False, soft_wrap=True)


def _bench_scale(into: str | None, *, as_json: bool) -> None:
    from services import cli_scale, kernels, scale_tables

    console, stop = err if as_json else out, _stop_on_signals()
    kernels.compile_all(console.print)
    try:
        with console.status("") as status:
            cli_scale.scale(out, status.update, stop, into=into, as_json=as_json)
    except scale_tables.BadPage as error:
        _bad_input(error)
    except Interrupted as error:
        err.print(str(error))
        raise typer.Exit(stop.exit_code) from None
    except _failures() as error:
        _fail(error)


@app.command()
def figures(
    store: Annotated[str, typer.Argument(help="SQLite file of a campaign, or of runs.")],
    folder: Annotated[str, typer.Option("--out", help="Where the figures go.")] = "figures",
) -> None:
    """Draw the paper's figures from a store, as PNG and PDF."""
    from pathlib import Path

    from services import figures as drawing
    from services.results import BadStore
    from services.store import Store

    if not Path(store).is_file():
        _bad_input(ValueError(f"{store}: no such store file"))
    try:
        files = drawing.draw_all(Store(store, read_only=True), Path(folder), err.print)
    except BadStore as error:
        _bad_input(ValueError(f"{store}: {error}"))
    except _failures() as error:
        _fail(error)
    except OSError as error:
        _fail(error)
    for file in files:
        out.print(str(file), highlight=False, markup=False, soft_wrap=True)


@app.command()
def verify(as_json: JsonOption = False) -> None:
    """Check this installation against theory: detector, disturbance, power allocation, beliefs. Under a minute."""
    from services import kernels
    from services import verify as verification

    console = err if as_json else out
    kernels.compile_all(console.print)
    with console.status("") as status:
        checks = verification.verify(status.update)
    if as_json:
        sys.stdout.write(json.dumps([check.as_json() for check in checks]) + "\n")
    else:
        out.print(verification.checks_table(checks))
    if not all(check.passed for check in checks):
        raise typer.Exit(FAILED)


class _Stop(threading.Event):
    """Set by SIGINT or SIGTERM; remembers which."""

    exit_code = 130


def _stop_on_signals() -> _Stop:
    import signal

    stop = _Stop()

    def on_signal(number: int, _frame: Any) -> None:
        stop.exit_code = 128 + number
        stop.set()

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    return stop


def _load(scenario: str) -> Scenario:
    try:
        return load(scenario)
    except ScenarioError as error:
        _bad_input(error)


def _bad_input(error: Exception) -> NoReturn:
    err.print(str(error), style="red", highlight=False, markup=False, soft_wrap=True)
    raise typer.Exit(BAD_INPUT) from None


def _fail(error: Exception) -> NoReturn:
    err.print(str(error), style="red", highlight=False, markup=False, soft_wrap=True)
    raise typer.Exit(FAILED) from None


def _failures() -> tuple[type[Exception], ...]:
    from services.store import StoreError

    return (RunFailed, StoreError, ConnectionError)


def _play(
    console: Console,
    stop: threading.Event,
    start: RunStart,
    planners: int,
    in_process: bool,
    store: str | None,
    connect: str | None,
) -> Result:
    from services import distributed, kernels
    from services import in_process as local
    from services.display import RunDisplay
    from services.store import Store

    with RunDisplay(console, start.dwells) as display:
        if connect:
            return distributed.play_on(connect, start, report=display.report, say=display.say, stop=stop)
        kernels.compile_all(display.say)
        if in_process:
            kept = Store(store or ":memory:")
            return local.play(start, planners=planners, store=kept, report=display.report, stop=stop)
        return distributed.play(
            start, planners=planners, store=store, report=display.report, say=display.say, stop=stop
        )


def _print_result(result: Result) -> None:
    from services.display import run_caption, run_table

    for table in run_table(result):
        out.print(table)
    out.print(run_caption(result), highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
