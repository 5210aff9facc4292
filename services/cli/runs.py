"""The commands about one run: playing it, here or on services that are up, and cancelling it."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cogradar.services.cli import completion
from cogradar.services.cli.console import (
    CONNECT_VARIABLE,
    DEFAULT_ENDPOINT,
    MAX_KILLS,
    ConnectOption,
    FrontEndOption,
    JsonOption,
    Pace,
    RateOption,
    RuleOption,
    RunDwellsOption,
    ScenarioArgument,
    SetOption,
    SharedServicesOption,
    Stop,
    ZenohConfigOption,
    command,
    err,
    out,
    print_json,
    rate_of,
    say,
)
from cogradar.services.cli.plugins.options import PluginsOption, StrategyOption
from cogradar.services.errors import BadInput
from cogradar.services.recorder.store.address import SHORT, shown
from cogradar.services.runs.run import Result, RunInterrupted, RunStopped, as_played, ending, program, untold
from cogradar.services.runs.run import loaded as loadable
from cogradar.services.topology import Start
from cogradar.services.web.address import DEFAULT as HTTP
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.tables import TRUE_RULES, marked

if TYPE_CHECKING:
    from cogradar.services.recorder.journal import Journal
    from cogradar.services.runs.launcher import LocalProcesses


ChaosOption = Annotated[
    float | None,
    typer.Option(min=0.001, max=MAX_KILLS, metavar="PER_MINUTE", help="Kill a process so many times a minute."),
]
DetachOption = Annotated[
    bool, typer.Option("--detach", help="With --connect: begin the run, print its name, and leave it alone.")
]
HttpOption = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT", help=f"Where HTTP is served, or at the next free port; {HTTP} if left out; off: nowhere."
    ),
]
KeepOption = Annotated[bool, typer.Option("--keep", help="Stay up after the last dwell, to be asked, until Ctrl-C.")]
MOST_OFF = 0.01  # of the duration of a dwell that the radar assumes
ENDLESS_STORE = "grows with each dwell until it has 4 GB of messages; the oldest dwells make room then"


def run(
    scenario: ScenarioArgument,
    settings: SetOption = None,
    strategy: StrategyOption = Strategy.POWER_AWARE,
    rule: RuleOption = None,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Seed of the whole run.")] = 1,
    dwells: RunDwellsOption = None,
    planners: Annotated[
        int, typer.Option(min=1, max=64, help="Number of planners; processes, unless --in-process.")
    ] = 1,
    in_process: Annotated[bool, typer.Option("--in-process", help="Run all in one process, without Zenoh.")] = False,
    store: Annotated[
        str | None,
        typer.Option(help=f"Keep the run in this SQLite file, or in {SHORT}.", autocompletion=completion.stores),
    ] = None,
    connect: SharedServicesOption = None,
    zenoh_config: ZenohConfigOption = None,
    pace: Annotated[Pace, typer.Option(help="As fast as possible, or by the clock.")] = Pace.LOCKSTEP,
    rate: RateOption = None,
    chaos: ChaosOption = None,
    detach: DetachOption = False,
    http: HttpOption = None,
    keep: KeepOption = False,
    front_end: FrontEndOption = Start.front_end,
    _plugins: PluginsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Play one run and print its results, on this machine or on running services."""
    console = err if as_json else out
    with command(zenoh_config=zenoh_config) as stop:
        loaded, ignores_world = _loaded(scenario, settings, rule, may_know=in_process), False
        if connect:
            _refuse_with_connect(local=in_process or bool(store) or planners != 1, chaos=chaos, front_end=front_end)
        else:
            is_simulated = front_end == Start.front_end
            ignores_world = not is_simulated and loaded.world is not None
            loaded = as_played(loaded, front_end)
            if not is_simulated:
                from cogradar.services.front_ends import settled

                front_end = settled(front_end)
        if (in_process or connect) and (keep or http is not None):
            raise BadInput("--http and --keep: of processes that this command starts; not with --in-process, --connect")
        if in_process and (pace is Pace.REALTIME or chaos):
            raise BadInput("--in-process is one process in lockstep: --pace realtime and --chaos do not apply")
        if detach and not connect:
            raise BadInput("--detach leaves a run to services that are up: it needs --connect")
        stored = store if dwells == NO_END or (dwells is None and loaded.dwells == NO_END) else None
        rate_hz = rate_of(loaded, pace, rate)
        is_live = rate_hz > 0.0 and not connect and front_end.partition(":")[0] not in {Start.front_end, "recorded"}
        for text in [
            *_remarks(turns=planners if in_process else 1, ignores_world=ignores_world, endless=stored),
            *(_other_time(rate_hz, loaded.radar.motion.dt_s) if is_live else ()),
        ]:
            say(text, err)
        start = loadable(RunStart.of(loaded, strategy, seed, dwells, rate_hz))
        show = partial(_show, store=store if store is None else shown(store), endpoint=connect, as_json=as_json)
        if connect and detach:
            _start(start, connect, stop, as_json=as_json)
            return
        with _shown_if_stopped(show):
            if connect:
                result = _play_on(console, stop, start, connect)
            elif in_process:
                result = _play_in_process(console, stop, start, planners, store, front_end)
            else:
                from cogradar.services.runs.launcher import LocalProcesses

                given = LocalProcesses(planners, store, front_end=front_end, http=HTTP if http is None else http)
                result = _play_here(console, stop, start, given, chaos, show if keep else None)
    if not keep:
        show(result)


@contextmanager
def _shown_if_stopped(show: Callable[[Result], None]) -> Iterator[None]:
    """Show what a run has come to that is ended before its time, by Ctrl-C or from elsewhere."""
    try:
        yield
    except (RunStopped, RunInterrupted) as stopped:
        if stopped.result is not None:
            show(stopped.result)
        raise


def _loaded(scenario: str, settings: list[str] | None, rule: str | None, *, may_know: bool) -> Scenario:
    """The scenario; a rule that knows the truth is refused, unless it may, and said to do so."""
    loaded = load(scenario, settings or (), rule=rule)
    if may_know and (played := loaded.radar.planner.rule) in TRUE_RULES:
        say(f"radar.planner.rule = {marked(played, played)}", err)
    return loaded if may_know else untold(loaded)


def _show(
    result: Result, *, store: str | None, as_json: bool, endpoint: str | None = None, url: str | None = None
) -> None:
    """Print a result: what happened, the table, what to type next, the digest."""
    from cogradar.services.cli.display import next_step, outcome, run_caption, run_digest, run_tables
    from cogradar.services.cli.terminal import print_tables

    if as_json:
        print_json(result.as_json())
    else:
        say(outcome(result))
        print_tables(out, run_tables(result))
        say(run_caption(result))
        say(next_step(program(), result, store, endpoint, url))
        say(run_digest(result))


def _remarks(*, turns: int, ignores_world: bool, endless: str | None) -> list[str]:
    """What an option means that may have been meant otherwise; endless: the store of a run without an end."""
    remarks = [] if endless is None else [f"{shown(endless)}: {ENDLESS_STORE}"]
    remarks += [f"--in-process: {turns} planners take turns in one process"] if turns > 1 else []
    return remarks + (["--front-end: the scenario's [world] is ignored, nothing is simulated"] if ignores_world else [])


def _other_time(rate_hz: float, dt_s: float) -> list[str]:
    """What becomes of speeds if a receiver of real targets has dwells of another length than the radar assumes."""
    factor = rate_hz * dt_s
    if abs(factor - 1.0) < MOST_OFF:
        return []
    than = f"{factor:.3g} times too small" if factor > 1.0 else f"{1.0 / factor:.3g} times too large"
    return [
        f"--rate {rate_hz:g}: a dwell takes {1.0 / rate_hz:g} s, the radar assumes radar.motion.dt_s = {dt_s:g}:"
        f" speeds of real targets would be {than}; --set radar.motion.dt_s={1.0 / rate_hz:g}"
    ]


def _refuse_with_connect(*, local: bool, chaos: float | None, front_end: str) -> None:
    """Raise BadInput for options that make no sense with services that are up."""
    if local:
        given = f"--connect (or {CONNECT_VARIABLE})"
        raise BadInput(f"{given} uses services that are up: --in-process, --store and --planners do not apply")
    if chaos:
        raise BadInput("--chaos kills processes that this command started: --connect does not apply")
    if front_end != Start.front_end:
        raise BadInput("--front-end: services that are up have their own; `cogradar service emulator` is told it")


def _play_on(console: Console, stop: Stop, start: RunStart, endpoint: str) -> Result:
    from cogradar.services.cli.display import RunDisplay
    from cogradar.services.runs import cluster as distributed

    with RunDisplay(console, start.dwells) as display:
        return distributed.play_on(endpoint, start, report=display.report, notify=display.notify, stop=stop)


def _play_in_process(
    console: Console, stop: Stop, start: RunStart, planners: int, store: str | None, front_end: str
) -> Result:
    ending(start)
    from cogradar.services.cli.display import RunDisplay

    with closing(_journal(store)) as journal, RunDisplay(console, start.dwells) as display:
        from cogradar.services import kernels
        from cogradar.services.metrics.store import Store
        from cogradar.services.runs import in_process

        kernels.compile_all(display.notify, stop)
        return in_process.play(
            start, planners=planners, store=Store(journal), report=display.report, stop=stop, front_end=front_end
        )


def _play_here(
    console: Console,
    stop: Stop,
    start: RunStart,
    given: "LocalProcesses",
    chaos: float | None,
    show: Callable[..., None] | None,
) -> Result:
    """Play a run with processes; `chaos` kills so many of them a minute.

    show : gets the result while the processes are up; they stay so until `stop` is set
    """
    from cogradar.services.cli.display import RunDisplay
    from cogradar.services.web.address import commanders, listen

    if (listener := listen(given.http)) is not None:  # what cannot be is refused before anything slow
        listener.close()
        commanders()
    journal = _journal(given.store)
    with RunDisplay(console, start.dwells) as display:
        with closing(journal):
            from cogradar.services import kernels
            from cogradar.services.runs import cluster

            kernels.compile_all(display.notify, stop)
        faults = None
        if chaos:
            from cogradar.services.runs.chaos import Chaos

            faults = Chaos(chaos, start.seed)

        def keep(result: Result, endpoint: str, url: str | None) -> None:
            display.stop()
            if show is not None:
                show(result, endpoint=endpoint, url=url)
            at = f", and HTTP at {url}" if url is not None else ""
            say(f"all processes stay up until Ctrl-C ends them: --connect {endpoint}{at}", err)

        result = cluster.play(
            start,
            replace(given, faults=faults),
            report=display.report,
            notify=display.notify,
            stop=stop,
            keep=keep if show is not None else None,
        )
        if faults:
            display.notify(f"{faults.killed} processes were killed")
        return result


def _journal(store: str | None) -> "Journal":
    """A journal, opened before anything slow: a store that cannot be one, or is in use, is refused at once."""
    from cogradar.services.recorder.journal import Journal
    from cogradar.services.recorder.store.tables import MEMORY

    return Journal(MEMORY if store is None else store, owner="cogradar run")


def _start(run: RunStart, connect: str, stop: Stop, *, as_json: bool) -> None:
    """Begin a run, leave it to the services, and print its name."""
    from cogradar.services.runs import cluster as distributed

    distributed.start_on(connect, run, notify=lambda text: err.print(text, soft_wrap=True), stop=stop)
    if as_json:
        print_json({"run": run.run})
    else:
        out.print(run.run, soft_wrap=True)


def cancel(
    run: Annotated[str, typer.Argument(help="Its name, as `cogradar query runs` shows it.")],
    connect: ConnectOption = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
) -> None:
    """End a run on running services before its time; its results so far stay in the store."""
    from cogradar.services.runs import cancel as cancelling

    with command(at_once=True, zenoh_config=zenoh_config):
        cancelling.cancel_on(connect, run)
    out.print(f"{run} is stopped", soft_wrap=True)


def command_run(
    run: Annotated[str, typer.Argument(help="Its name, as `cogradar query runs` shows it.")],
    action: Annotated[
        list[str],
        typer.Argument(
            metavar="ACTION...",
            help="power SHARE; sector blank|normal|double FROM TO; look BEARING DWELLS SHARE; drop TRACK;"
            " priority TRACK WEIGHT; accuracy TRACK KM|none; set strategy|rule|objective VALUE; pause [DWELLS];"
            " resume; or end."
            " Bearings are in degrees from boresight, shares are of the array's power.",
        ),
    ],
    at: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Earliest dwell, counted from 0.")] = 0,
    connect: ConnectOption = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Command a run that goes on; `cogradar query commands` lists what was asked of it, by whom, and from when on."""
    from cogradar.services.runs.command import command_on

    with command(at_once=True, zenoh_config=zenoh_config):
        row = command_on(connect, run, action, at)
    if as_json:
        print_json(row)
    else:
        later = f", the first that can still obey: dwell {at} is too soon" if 0 < at < row["k"] else ""
        out.print(f"{run}: {row['action']} from dwell {row['k']} on{later}", soft_wrap=True)
