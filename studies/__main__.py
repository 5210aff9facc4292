"""The studies' command line: `python -m studies NAME`."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cogradar.services.analysis.tables import Table, check_page
from cogradar.services.cli import completion
from cogradar.services.cli.console import (
    CONNECT_VARIABLE,
    DEFAULT_ENDPOINT,
    JsonOption,
    Stop,
    ZenohConfigOption,
    call,
    command,
    endpoints,
    err,
    out,
    print_json,
    progress,
)
from cogradar.services.cli.terminal import print_tables
from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.runs.run import untold
from cogradar.shared.scenario.files import load

SCALING, CROWD, DECISIONS, TRACKERS, AGENTS = "scale", "crowd", "judged", "trackers", "agents"  # markers in pages
ACCURACIES, AGES, PEERS = "accuracies", "ages", "peers"
MAX_AT_ONCE = 64  # runs, in `load`
EXPLAINED = 10  # faults of a soak

app = typer.Typer(
    name="python -m studies",
    help="Measurements and comparisons that the documents report. Each takes some minutes, the soak half an hour.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

IntoOption = Annotated[str | None, typer.Option(help="Markdown page whose tables to rewrite, between markers.")]
ScenarioOption = Annotated[str, typer.Option(help="What is played.", autocompletion=completion.scenarios)]
DwellsOption = Annotated[int, typer.Option(min=2, max=10_000, help="Of each run.")]
PairsOption = Annotated[int, typer.Option(min=1, max=1000, help="Pairs of runs.")]


@contextmanager
def _measuring(stop: Stop, *, as_json: bool) -> Iterator[Callable[[str], None]]:
    """Compile the kernels, then show progress; with --json on standard error."""
    from cogradar.services import kernels

    console: Console = err if as_json else out
    kernels.compile_all(lambda text: console.print(text, soft_wrap=True), stop)
    with progress(console) as tell:
        yield tell


def _show(tables: Sequence[Table], document: object, *, as_json: bool, remark: str = "") -> None:
    if as_json:
        print_json(document)
        return
    print_tables(out, tables)
    if remark:
        out.print(remark, soft_wrap=True)


@app.command()
def scaling(into: IntoOption = None, as_json: JsonOption = False) -> None:
    """Measure what being distributed costs: the same runs in one process and over Zenoh, planners that join."""
    from studies import page
    from studies.scaling import joins, runs, tables

    with command() as stop:
        if into:
            page.check_quiet(Path(into), [SCALING])
        with _measuring(stop, as_json=as_json) as tell:
            measured, joined = runs.measure(tell, stop), joins.measure(tell, stop)
        shown, remark = [*tables.tables(measured), joins.table(joined)], tables.remark()
        if into:
            page.write(Path(into), SCALING, shown, remark)
    document = tables.as_json(measured) | {"joins": [vars(one) for one in joined]}
    _show(shown, document, as_json=as_json, remark=page.caption() + remark)


@app.command()
def realtime(as_json: JsonOption = False) -> None:
    """Find the highest rate that this machine sustains in real time, by number of targets and planners."""
    from studies.processes import realtime as study

    with command() as stop, _measuring(stop, as_json=as_json) as tell:
        cells = study.bench(tell, stop)
    _show([study.table(cells)], [cell.as_json() for cell in cells], as_json=as_json, remark=study.remark(cells))


@app.command(name="load")
def load_(
    connect: Annotated[
        str, typer.Option(envvar=CONNECT_VARIABLE, callback=endpoints, help="The router of the services.")
    ] = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
    at_once: Annotated[str, typer.Option(help="Numbers of runs at once.")] = "1,2,4",
    scenario: ScenarioOption = "paper",
    dwells: DwellsOption = 60,
    as_json: JsonOption = False,
) -> None:
    """Play several runs at once on services that are up: runs per minute and the time of a dwell."""
    from studies.processes import load as study

    with command(zenoh_config=zenoh_config) as stop:
        numbers = at_once.split(",")
        if not all(number.isdecimal() and 1 <= int(number) <= MAX_AT_ONCE for number in numbers):
            raise BadInput(f"--at-once {at_once}: must be numbers from 1 to {MAX_AT_ONCE}, such as 1,2,4")
        played = untold(load(scenario))
        with progress(err if as_json else out) as tell:
            loads = study.measure(connect, played, dwells, [int(number) for number in numbers], tell, stop)
    _show([study.table(loads)], study.as_json(loads), as_json=as_json)


@app.command()
def watched(pairs: PairsOption = 10, as_json: JsonOption = False) -> None:
    """Measure what clients, scrapes and frozen readers cost a run, against runs alone."""
    from studies.processes import watched as study

    with command() as stop, _measuring(stop, as_json=as_json) as tell:
        measured = study.measure(pairs, study.DWELLS, tell, stop)
    _show([study.table(measured)], study.as_json(measured), as_json=as_json)


@app.command()
def secured(
    scenario: ScenarioOption = "paper", dwells: DwellsOption = 60, pairs: PairsOption = 10, as_json: JsonOption = False
) -> None:
    """Measure what certificates and access control cost a dwell, against one without."""
    from studies.processes import load as study

    with command() as stop, _measuring(stop, as_json=as_json) as tell:
        found = study.secured(untold(load(scenario)), dwells, pairs, tell, stop)
    _show([study.table_of_secured(found)], asdict(found), as_json=as_json)


@app.command()
def crowd(into: IntoOption = None, as_json: JsonOption = False) -> None:
    """Measure what 100, 300 and 1000 tracks cost: processor and memory, in real time and in lockstep."""
    from studies import page
    from studies.processes import crowd as study

    with command() as stop:
        if into:
            page.check_quiet(Path(into), [CROWD])
        with _measuring(stop, as_json=as_json) as tell:
            found = study.measure(tell, stop)
        if into:
            page.write(Path(into), CROWD, study.tables(found))
    _show(study.tables(found), study.as_json(found), as_json=as_json)


@app.command()
def accuracies(
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Skies.")] = 5,
    dwells: DwellsOption = 120,
    into: IntoOption = None,
) -> None:
    """Ask for the accuracy of tracks: in how many dwells they have it, and what it costs the others."""
    from cogradar.services.analysis.pages import write_into
    from studies.decisions import accuracies as study

    with command() as stop:
        if into:
            check_page(Path(into), [ACCURACIES])
        with _measuring(stop, as_json=False) as tell:
            found = study.tables(study.measure(range(1, seeds + 1), dwells, tell, stop))
        if into:
            write_into(Path(into), {ACCURACIES: [found[0]]})
    print_tables(out, found)


@app.command()
def soak(
    minutes: Annotated[float, typer.Option(min=0.5, max=10_000, help="How long.")] = 30.0, as_json: JsonOption = False
) -> None:
    """Run, kill, look and ask at once for long; exit code 1 if what is held grows or a question has no answer."""
    from studies.soak import soak as study

    with command() as stop:
        with _measuring(stop, as_json=as_json) as tell:
            found = study.soak(minutes, 1, tell, stop)
        _show([study.table(found)], found.as_json(), as_json=as_json, remark=study.remark(found))
        if found.faults:
            raise RunFailed("\n".join(found.faults[:EXPLAINED]))


@app.command()
def endless(
    minutes: Annotated[float, typer.Option(min=0.1, max=100_000, help="How long.")] = 10.0,
    dwells: Annotated[
        int | None, typer.Option(min=1, max=100_000_000, help="How many in place of how long; a week has 6 048 000.")
    ] = None,
    store: Annotated[str | None, typer.Option(help="File to keep the run in, and to go on from.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Play a run without an end as fast as it goes; exit code 1 if what is held, or the CPU time of a dwell, grows."""
    from studies.soak import endless as study

    with command() as stop:
        with _measuring(stop, as_json=as_json) as tell:
            found = study.play(minutes, 1, tell, stop, dwells, store)
        _show([found.table()], found.as_json(), as_json=as_json)
        if found.faults:
            raise RunFailed("\n".join(found.faults))


@app.command()
def ages(
    aircraft: Annotated[int, typer.Option(min=1, max=600, help="That come within three minutes.")] = 128,
    rate: Annotated[float, typer.Option(min=0.1, max=20.0, help="Dwells a second.")] = 1.0,
    dwells: Annotated[int, typer.Option(min=10, max=100_000, help="That count.")] = 300,
    into: IntoOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how old a track is where a feed sends it; exit code 1 if more than 1 % are 200 ms old."""
    from studies import page
    from studies.processes import ages as study

    with command() as stop:
        if into:
            check_page(Path(into), [AGES])
        with _measuring(stop, as_json=as_json) as tell:
            found = study.measure(aircraft, rate, dwells, tell, stop)
        if into:
            page.write(Path(into), AGES, [study.table(found)])
        _show([study.table(found)], study.as_json(found), as_json=as_json)
        if not found.is_met:
            raise RunFailed(f"99 % of the tracks are younger than {found.p99_ms:.0f} ms; asked: {study.GOAL_MS:.0f} ms")


@app.command()
def decisions(
    scenario: ScenarioOption = "paper",
    over: Annotated[
        list[str] | None, typer.Option(metavar="KEY[,KEY]=V1,V2,...", help="As of `cogradar sweep`; may repeat.")
    ] = None,
    runs: Annotated[int, typer.Option(min=1, max=1000, help="Seeds of each combination.")] = 3,
    into: IntoOption = None,
) -> None:
    """Judge decisions one by one: are they provably the best, and what does each policy lose?"""
    from cogradar.services.analysis.pages import write_into
    from studies.decisions import decisions as study

    with command() as stop:
        if into:
            check_page(Path(into), [DECISIONS])
        with _measuring(stop, as_json=False) as tell:
            table = study.play(scenario, over or study.OVER, runs, tell, stop)
        if into:
            write_into(Path(into), {DECISIONS: [table]})
    print_tables(out, [table])


@app.command()
def peers(
    scenario: ScenarioOption = "paper",
    runs: Annotated[int, typer.Option(min=1, max=1000, help="Whose decisions are made again, seeds from 1.")] = 2,
    decisions: Annotated[int, typer.Option(min=1, max=10_000, help="Of the ones that are not proved, at most.")] = 80,
    simulations: Annotated[str, typer.Option(help="Of a decision.")] = "1000,12000",
    into: IntoOption = None,
) -> None:
    """Let pomdp-py make the radar's decisions, and compare value and time with the radar's own search."""
    from studies import page
    from studies.peers import peers as study

    with command() as stop:
        numbers = simulations.split(",")
        if not all(number.isdecimal() and 1 <= int(number) <= 1_000_000 for number in numbers):
            raise BadInput(f"--simulations {simulations}: must be numbers from 1 to 1000000, such as 1000,12000")
        if into:
            check_page(Path(into), [PEERS])
        study.solvers()
        with _measuring(stop, as_json=False) as tell:
            found = study.play(scenario, runs, decisions, [int(number) for number in numbers], tell, stop)
        if into:
            page.write(Path(into), PEERS, [found])
    print_tables(out, [found])


@app.command()
def recorded(
    sample: Annotated[str, typer.Argument(help="A collection of the package `traffic`, such as quickstart.")],
    begin: Annotated[float, typer.Option(help="Seconds since 1970, UTC.")],
    end: Annotated[float, typer.Option(help="Likewise.")],
    file: Annotated[Path, typer.Option("--out", help="A CSV file for `cogradar sky --from`.")],
) -> None:
    """Write recorded positions of aircraft as a table."""
    from studies import recorded as study

    with command(at_once=True):
        out.print(f"{file}: {study.write(sample, begin, end, file)} positions", soft_wrap=True)


@app.command()
def trackers(
    skies: Annotated[list[str], typer.Argument(help="Scenarios; or dense, six, formation, made anew for each seed.")],
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each sky, seeds from 1.")] = 5,
    dwells: Annotated[int, typer.Option(min=20, max=10_000, help="Of a run, at most.")] = 150,
    store: Annotated[Path, typer.Option(help="Folder of the scores; what it has is not played again.")] = Path(
        "build/trackers"
    ),
    into: IntoOption = None,
) -> None:
    """Compare this radar's tracker with an IMM-EKF and a UKF of Stone Soup on the same detections."""
    from cogradar.services.analysis.pages import write_into
    from studies.trackers import table as study

    with command() as stop:
        if into:
            check_page(Path(into), [TRACKERS])
        with _measuring(stop, as_json=False) as tell:
            found = study.table(study.play(skies, seeds, dwells, store, tell, stop))
        if into:
            write_into(Path(into), {TRACKERS: [found]})
    print_tables(out, [found])


@app.command()
def agents(
    scenario: ScenarioOption = "starved",
    seeds: Annotated[int, typer.Option(min=2, max=1000, help="Runs of each policy, seeds from 1.")] = 20,
    dwells: DwellsOption = 60,
    into: IntoOption = None,
) -> None:
    """Train an agent in an environment, and compare it with others and with the radar's own rules."""
    from cogradar.services.analysis.pages import write_into
    from studies.decisions import agents as study

    with command() as stop:
        if into:
            check_page(Path(into), [AGENTS])
        with _measuring(stop, as_json=False) as tell:
            found = study.table(scenario, seeds, dwells, tell, stop)
        if into:
            write_into(Path(into), {AGENTS: [found]})
    print_tables(out, [found])


if __name__ == "__main__":
    call(app)
