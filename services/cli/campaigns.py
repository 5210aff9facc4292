"""The commands about many runs: campaign, sweep, report, figures."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from cogradar.services.cli import completion
from cogradar.services.cli.console import (
    BUILD,
    CsvOption,
    DwellsOption,
    JsonOption,
    RuleOption,
    RunFilter,
    ScenarioArgument,
    ScenarioFilter,
    SeedFilter,
    SetOption,
    Stop,
    command,
    err,
    filters,
    new_folder,
    newest_store,
    out,
    page,
    print_csv,
    print_json,
    say,
)
from cogradar.services.cli.plugins.options import PluginsOption, StrategyFilter
from cogradar.services.errors import BadInput, Damaged, RunFailed, check_stop
from cogradar.services.recorder.store.address import SHORT, label
from cogradar.services.runs.run import as_played
from cogradar.services.topology import Start
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

if TYPE_CHECKING:
    from cogradar.services.campaigns.campaign import Campaign
    from cogradar.services.campaigns.pool import Pool
    from cogradar.services.cli.display import CampaignDisplay
    from cogradar.services.metrics.experiments import Experiment
    from cogradar.services.metrics.store import Store

ALL = ",".join(Strategy)
ALL_RUNS = "all"
DaskOption = Annotated[
    str | None, typer.Option("--dask", metavar="ADDRESS", help="Run on the workers of this Dask scheduler.")
]

# What campaign and sweep have in common.
ResultsOption = Annotated[
    str, typer.Option(help=f"Store of the results: SQLite file, or {SHORT}.", autocompletion=completion.stores)
]
StrategiesOption = Annotated[
    str | None, typer.Option(help="Comma-separated; all if left out.", autocompletion=completion.strategies)
]
FirstSeedOption = Annotated[int, typer.Option(min=0, max=10**9, help="Seed of the first run; the others follow.")]
WorkersOption = Annotated[int | None, typer.Option(min=1, max=1024, help="Processes; one per core if left out.")]
IntoOption = Annotated[
    str | None, typer.Option(metavar="PAGE", callback=page, help="Markdown page: tables between its markers.")
]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Go on with what the store has.")]


def campaign(
    scenario: ScenarioArgument,
    store: ResultsOption,
    runs: Annotated[int, typer.Option(min=1, max=1_000_000, help="Runs per strategy.")] = 100,
    strategies: StrategiesOption = None,
    rule: RuleOption = None,
    seed: FirstSeedOption = 1,
    dwells: DwellsOption = None,
    settings: SetOption = None,
    workers: WorkersOption = None,
    resume: ResumeOption = False,
    dask: DaskOption = None,
    _plugins: PluginsOption = None,
) -> None:
    """Make many runs on all cores, with the same seeds for every strategy.

    `cogradar report` summarises them.
    """
    from cogradar.services.campaigns import campaign as campaigns

    with command() as stop:
        loaded = as_played(load(scenario, settings or (), rule=rule), Start.front_end)
        asked = campaigns.Campaign(
            (loaded,), campaigns.parse_strategies(strategies or ALL), runs, seed, dwells or loaded.dwells
        )
        play(asked, store, workers, dask, stop, resume=resume).close()


def sweep(
    scenario: ScenarioArgument,
    over: Annotated[
        list[str],
        typer.Option(
            metavar="KEY[,KEY]=V1,V2,...",
            help="An axis: values of a key, radar.array.n_tx=16,32, or of keys that change together. May repeat.",
        ),
    ],
    store: ResultsOption,
    runs: Annotated[int, typer.Option(min=1, max=1_000_000, help="Runs per combination and strategy.")] = 20,
    strategies: StrategiesOption = None,
    seed: FirstSeedOption = 1,
    dwells: DwellsOption = None,
    settings: SetOption = None,
    workers: WorkersOption = None,
    resume: ResumeOption = False,
    dask: DaskOption = None,
    _plugins: PluginsOption = None,
    against: Annotated[
        str | None, typer.Option(metavar="KEY=VALUE", help="Compare with this value of an axis, within seeds.")
    ] = None,
    folder: Annotated[
        str | None,
        typer.Option("--out", metavar="FOLDER", callback=new_folder, help="Draw a figure of one or two axes there."),
    ] = None,
    into: IntoOption = None,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
) -> None:
    """Run every combination of settings with the same seeds, and print tables.

    With --out it draws a figure, of one or two axes.

    Each combination is a scenario of its own in the store, NAME-1, NAME-2
    and so on, for `cogradar report --scenario`. A comma within brackets or
    quotes belongs to the value.
    """
    from cogradar.services.campaigns import campaign as campaigns
    from cogradar.services.cli.terminal import print_tables
    from cogradar.services.sweeps import grid

    if as_json and as_csv:
        raise typer.BadParameter("--json and --csv: one of them")
    with command() as stop:
        axes = [grid.axis(text) for text in over]
        base = grid.baseline(against, axes) if against else None
        variants = grid.variants(scenario, settings or (), axes)
        played = tuple(as_played(variant.scenario, Start.front_end) for variant in variants)
        chosen = campaigns.parse_strategies(strategies or ALL)
        asked = campaigns.Campaign(played, chosen, runs, seed, dwells)
        console = err if as_json or as_csv else out
        with closing(play(asked, store, workers, dask, stop, resume=resume, console=console)) as kept:
            from cogradar.services.sweeps import (  # imports what draws: not before the runs are there
                differences,
                results,
            )

            found = results.rows(kept, axes, variants)
            tables = [results.table(found, axes), results.whole_table(results.whole_rows(kept, axes, variants), axes)]
            if base is not None:
                found = differences.compared(found, kept, variants, *base)
                tables.append(differences.table(found, axes, *base))
            remarks = results.remarks(kept, found)
            first = results.first_of(kept, scenario, settings or (), axes, variants[0])
        if into:
            results.write(Path(into), label(store), tables, [*remarks, *first])
        files = results.draw(found, axes, Path(folder)) if folder else []
    if as_json:
        print_json(found)
    elif as_csv:
        print_csv(found)
    else:
        print_tables(out, tables)
        say("\n".join([*remarks, *map(str, files)]))


def play(
    asked: "Campaign",
    file: str,
    workers: int | None,
    dask: str | None,
    stop: Stop,
    *,
    resume: bool,
    console: Console = out,
) -> "Store":
    """Play a campaign into a store, here or on a cluster, print what it took, and leave the store open."""
    from cogradar.services import kernels
    from cogradar.services.campaigns import campaign as campaigns
    from cogradar.services.campaigns.pool import LocalPool, n_core
    from cogradar.services.cli.display import CampaignDisplay, campaign_caption

    if dask and workers:
        raise BadInput("--workers: counts workers of this machine; a Dask cluster has its own")
    kept = campaigns.open_store(file, asked, resume=resume)
    with ExitStack() as on_failure, CampaignDisplay(console) as display:
        on_failure.callback(kept.close)
        kernels.compile_all(display.notify, stop)
        with _cluster(dask, asked, display, stop) if dask else nullcontext(LocalPool(workers or n_core())) as pool:
            tally = campaigns.play(asked, kept, pool, report=display.report, notify=display.notify, stop=stop)
        on_failure.pop_all()
    say(campaign_caption(tally, campaigns.conflicts(kept), campaigns.results_digest(kept)), console)
    return kept


def _cluster(address: str, asked: "Campaign", display: "CampaignDisplay", stop: Stop) -> AbstractContextManager["Pool"]:
    try:
        from cogradar.services.campaigns import dask_pool
    except ModuleNotFoundError as error:
        raise BadInput(f"--dask: {error.name} is not installed; pip install 'cogradar[dask]' brings it") from None
    return dask_pool.cluster(address, asked.starts()[0], notify=display.notify, check=partial(check_stop, stop))


def report(
    stores: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="STORE...",
            help="Stores, each of a campaign or of other complete runs; the newest of build/ if left out.",
            autocompletion=completion.stores,
        ),
    ] = None,
    run: RunFilter = None,
    scenario: ScenarioFilter = None,
    strategy: StrategyFilter = None,
    seed: SeedFilter = None,
    into: IntoOption = None,
    as_json: JsonOption = False,
) -> None:
    """Summarise stored runs: detection, errors, lost tracks, strategies, with intervals.

    Runs of different scenarios, or numbers of dwells, are reported on one by
    one. Of runs of equal scenario, strategy, seed and dwells the newest counts.
    Damaged runs are left out and named, with exit code 2; a PAGE is not written
    then.
    """
    from cogradar.services.analysis import report_tables
    from cogradar.services.analysis.report import report as report_on
    from cogradar.services.cli.terminal import print_tables

    with command(at_once=True):
        chosen = filters(run=run or ALL_RUNS, scenario=scenario, strategy=strategy, seed=seed)
        found, damaged = list[dict[str, Any]](), list[Damaged]()
        for file in stores or [_newest()]:
            with _experiments(file, chosen, damaged) as (store, there):
                found += [report_on(store, experiment) for experiment in there]
        if into:
            for error in damaged:  # a page does not say what its tables are without
                raise error
            report_tables.write(Path(into), found)
        if as_json:
            print_json(found[0] if len(found) == 1 else found)
        for one in [] if as_json else found:
            say(report_tables.heading(one), style="bold")
            say(report_tables.verdict(one))
            print_tables(out, report_tables.tables(one))
            say(report_tables.caption(one))
        _say_left_out(damaged)


def _newest() -> str:
    """The newest store of build/, which is said. Raises BadInput if there is none."""
    if (found := newest_store()) is None:
        raise BadInput(f"no STORE, and no *.db in {BUILD}/: name one")
    say(f"{found}: the newest store in {BUILD}/", err)
    return found


def _say_left_out(damaged: list[Damaged]) -> None:
    """Name the runs that a result is without. Raises Damaged if there is one."""
    for one in damaged:
        say(f"left out: {one}", err)
    if damaged:
        raise Damaged(f"damaged runs that were left out: {len(damaged)}")


@contextmanager
def _experiments(
    file: str, chosen: dict[str, str], damaged: list[Damaged]
) -> "Iterator[tuple[Store, list[Experiment]]]":
    """A store and what it holds of what was chosen, without damaged runs; a failure names the file."""
    from cogradar.services.metrics import client as asking
    from cogradar.services.metrics.experiments import experiments
    from cogradar.services.metrics.selection import Selection

    with closing(asking.open_store(file)) as store:
        try:
            yield store, experiments(store, Selection.of(chosen), damaged.append)
        except BadInput as error:
            raise BadInput(f"{store.journal.path}: {error}") from None


def figures(
    store: Annotated[
        str | None,
        typer.Argument(
            metavar="STORE",
            help="Store of a campaign, or of runs; the newest of build/ if left out.",
            autocompletion=completion.stores,
        ),
    ] = None,
    run: RunFilter = None,
    scenario: ScenarioFilter = None,
    strategy: StrategyFilter = None,
    seed: SeedFilter = None,
    folder: Annotated[
        str, typer.Option("--out", metavar="FOLDER", callback=new_folder, help="Where the figures go.")
    ] = "figures",
) -> None:
    """Draw the paper's figures from a store, as PNG and PDF.

    Runs of different scenarios, or numbers of dwells, have a folder each. Of
    runs of equal scenario, strategy, seed and dwells the newest counts.
    """
    from cogradar.services.analysis.drawing import figures as drawing

    chosen = filters(run=run or ALL_RUNS, scenario=scenario, strategy=strategy, seed=seed)
    damaged = list[Damaged]()
    with command(at_once=True), _experiments(store or _newest(), chosen, damaged) as (opened, found):
        files = list[Path]()
        for experiment in found:
            place = Path(folder) if len(found) == 1 else Path(folder, experiment.label)
            try:
                files += drawing.draw_all(opened, experiment, place, err.print)
            except OSError as error:
                raise RunFailed(f"{error.filename or place}: {error.strerror or error}") from None
        for file in files:
            out.print(str(file), soft_wrap=True)
        _say_left_out(damaged)
