"""The commands about many runs: campaign, report, figures, chaos."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.cli import completion
from services.cli.console import (
    MAX_KILLS,
    DwellsOption,
    JsonOption,
    RunFilter,
    ScenarioArgument,
    ScenarioFilter,
    SeedFilter,
    SetOption,
    StrategyFilter,
    command,
    endpoints,
    err,
    filters,
    out,
    print_json,
)
from services.errors import BadInput, RunFailed
from services.runs.run import as_played
from services.topology import Start
from shared.scenario.files import load
from shared.scenario.radar_config import Strategy

if TYPE_CHECKING:
    from services.analysis.experiments import Experiment
    from services.metrics.store import Store

ALL = ",".join(Strategy)
ALL_RUNS = "all"


def campaign(
    scenario: ScenarioArgument,
    store: Annotated[str, typer.Option(help="SQLite file of the results.", autocompletion=completion.stores)],
    runs: Annotated[int, typer.Option(min=1, max=1_000_000, help="Runs per strategy.")] = 100,
    strategies: Annotated[
        str | None,
        typer.Option(help="Comma-separated; all three if left out.", autocompletion=completion.strategies),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=10**9, help="Seed of the first run; the others follow.")] = 1,
    dwells: DwellsOption = None,
    settings: SetOption = None,
    workers: Annotated[int | None, typer.Option(min=1, max=1024, help="Processes; one per core if left out.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what the store has.")] = False,
    connect: Annotated[
        str | None,
        typer.Option(
            callback=endpoints,
            help="Use the services behind this router; --workers is then the runs at once, two per planner.",
        ),
    ] = None,
) -> None:
    """Play many runs on all cores, same seeds for every strategy; `cogradar report` says what came out."""
    from services import kernels
    from services.campaigns import campaign as campaigns
    from services.campaigns import connected as campaign_connected
    from services.cli.display import CampaignDisplay, campaign_caption

    with command() as stop:
        loaded = as_played(load(scenario, settings or ()), Start.front_end)
        asked = campaigns.Campaign(
            loaded, campaigns.parse_strategies(strategies or ALL), runs, seed, dwells or loaded.dwells
        )
        kept = campaigns.open_store(store, asked, resume=resume)
        with CampaignDisplay(out) as display:
            if connect:
                tally = campaign_connected.play(
                    asked, kept, connect, workers, report=display.report, notify=display.notify, stop=stop
                )
            else:
                kernels.compile_all(display.notify, stop)
                n_worker = workers or campaigns.n_core()
                tally = campaigns.play(asked, kept, n_worker, report=display.report, notify=display.notify, stop=stop)
        out.print(campaign_caption(tally, campaigns.conflicts(kept), campaigns.results_digest(kept)), soft_wrap=True)


def report(
    stores: Annotated[
        list[str],
        typer.Argument(
            metavar="STORE...",
            help="SQLite files, each of a campaign or of other complete runs.",
            autocompletion=completion.stores,
        ),
    ],
    run: RunFilter = None,
    scenario: ScenarioFilter = None,
    strategy: StrategyFilter = None,
    seed: SeedFilter = None,
    into: Annotated[
        str | None, typer.Option(help="Markdown file whose tables to rewrite, between its markers.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what the runs of a store show: detection, errors, lost tracks, strategies compared, all with intervals.

    Runs of different scenarios, or numbers of dwells, are reported on one by
    one. Of runs of equal scenario, strategy, seed and dwells the newest counts.
    """
    from services.analysis import report_tables
    from services.cli.terminal import print_tables

    with command(at_once=True):
        chosen = filters(run=run or ALL_RUNS, scenario=scenario, strategy=strategy, seed=seed)
        found = [one for store in stores for one in _report_on(store, chosen)]
        if into:
            report_tables.write(Path(into), found)
    if as_json:
        print_json(found[0] if len(found) == 1 else found)
        return
    for one in found:
        print_tables(out, report_tables.tables(one))
        out.print(report_tables.caption(one), soft_wrap=True)


def _report_on(file: str, chosen: dict[str, str]) -> list[dict[str, Any]]:
    from services.analysis.report import report as report_on

    with _experiments(file, chosen) as (store, found):
        return [report_on(store, experiment) for experiment in found]


@contextmanager
def _experiments(file: str, chosen: dict[str, str]) -> "Iterator[tuple[Store, list[Experiment]]]":
    """A store and what it holds of what was chosen; a failure names the file."""
    from services.analysis.experiments import experiments
    from services.metrics import client as asking
    from services.metrics.selection import Selection

    with closing(asking.open_store(file)) as store:
        try:
            yield store, experiments(store, Selection.of(chosen))
        except BadInput as error:
            raise BadInput(f"{file}: {error}") from None


def chaos(
    scenario: ScenarioArgument = "smoke",
    runs: Annotated[int, typer.Option(min=1, max=10_000, help="Seeds 1 to this.")] = 20,
    dwells: Annotated[int, typer.Option(min=1, max=1_000_000, help="Of each run.")] = 1000,
    settings: SetOption = None,
    planners: Annotated[int, typer.Option(min=1, max=64, help="Planner processes.")] = 3,
    rate: Annotated[float, typer.Option(min=0.001, max=MAX_KILLS, help="Processes killed a minute.")] = 20.0,
) -> None:
    """Kill processes of running systems at random, and compare each run with the same one left in peace."""
    from services import kernels
    from services.cli.display import RunDisplay
    from services.runs.chaos import trials

    killed = differing = 0
    with command() as stop:
        loaded = as_played(load(scenario, settings or ()), Start.front_end)
        with RunDisplay(out, dwells) as display:
            kernels.compile_all(display.notify, stop)
            for trial in trials(
                loaded, dwells, planners, runs, rate, report=display.report, notify=lambda _: None, stop=stop
            ):
                killed, differing = killed + trial.killed, differing + (not trial.same)
                verdict = "same digest" if trial.same else f"DIFFERS: {trial.digest}, expected {trial.expected}"
                display.notify(
                    f"seed {trial.seed}: {trial.killed} processes killed, {trial.elapsed_s:.1f} s, {verdict}"
                )
        out.print(f"{runs} runs, {killed} processes killed, {differing} runs differ from those left in peace")
    if differing:
        raise typer.Exit(RunFailed.exit_code)


def figures(
    store: Annotated[
        str, typer.Argument(help="SQLite file of a campaign, or of runs.", autocompletion=completion.stores)
    ],
    run: RunFilter = None,
    scenario: ScenarioFilter = None,
    strategy: StrategyFilter = None,
    seed: SeedFilter = None,
    folder: Annotated[str, typer.Option("--out", help="Where the figures go.")] = "figures",
) -> None:
    """Draw the paper's figures from a store, as PNG and PDF.

    Runs of different scenarios, or numbers of dwells, have a folder each. Of
    runs of equal scenario, strategy, seed and dwells the newest counts.
    """
    from services.analysis import figures as drawing

    chosen = filters(run=run or ALL_RUNS, scenario=scenario, strategy=strategy, seed=seed)
    files: list[Path] = []
    with command(at_once=True), _experiments(store, chosen) as (opened, found):
        for experiment in found:
            place = Path(folder) if len(found) == 1 else Path(folder, experiment.label)
            try:
                files += drawing.draw_all(opened, experiment, place, err.print)
            except OSError as error:
                raise RunFailed(str(error)) from None
    for file in files:
        out.print(str(file), soft_wrap=True)
