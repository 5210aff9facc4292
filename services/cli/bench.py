"""The commands about this installation: bench, verify and simulate."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from services.analysis.tables import Table, check_page
from services.cli import completion
from services.cli.console import (
    CONNECT_VARIABLE,
    DEFAULT_ENDPOINT,
    JsonOption,
    Stop,
    ZenohConfigOption,
    command,
    endpoints,
    err,
    out,
    print_json,
    progress,
)
from services.cli.terminal import print_tables
from services.errors import BadInput, RunFailed
from services.runs.run import untold
from shared.scenario.files import load

# As in services.bench.cases, which is too slow to import for a line of help.
CASES = (
    *("pomcp_literal", "pomcp", "exact", "mode", "mean", "belief_resample", "belief_rejection"),
    *("predict_mixture", "weigh_looks", "regularise_looks", "directions", "cell", "monopulse"),
    *("allocate_3", "allocate_10", "allocate_30", "allocate_100", "joint_3", "joint_12", "joint_100"),
    *("urgency_100", "wide_12", "dwell_in_process", "dwell_zenoh"),
)
MAX_AT_ONCE = 64  # runs, in `bench load`
SCALE, CROWD = "scale", "crowd"
ALONE = (SCALE, "realtime", "load", "watched", "secured", CROWD, "soak")
EXPLAINED = 10  # failing schedules


def bench(
    cases: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CASE]...",
            autocompletion=lambda incomplete: [name for name in (*CASES, *ALONE) if name.startswith(incomplete)],
            help=f"Only these cases, of {', '.join(CASES)}; or one of {', '.join(ALONE)}. All cases if left out.",
        ),
    ] = None,
    into: Annotated[
        str | None,
        typer.Option(help="With `scale`, `crowd`: Markdown page whose tables to rewrite, between markers."),
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(envvar=CONNECT_VARIABLE, callback=endpoints, help="With `load`: the router of the services."),
    ] = None,
    zenoh_config: ZenohConfigOption = None,
    at_once: Annotated[str, typer.Option(help="With `load`: numbers of runs at once.")] = "1,2,4",
    scenario: Annotated[
        str, typer.Option(help="With `load`, `secured`: what is played.", autocompletion=completion.scenarios)
    ] = "paper",
    dwells: Annotated[int, typer.Option(min=2, max=10_000, help="With `load`, `secured`: of each run.")] = 60,
    pairs: Annotated[int, typer.Option(min=1, max=1000, help="With `watched`, `secured`: of runs, for each row.")] = 10,
    minutes: Annotated[float, typer.Option(min=0.5, max=10_000, help="With `soak`: how long.")] = 30.0,
    as_json: JsonOption = False,
) -> None:
    """Time the kernels and a whole dwell: medians of many repeats, beside the goals.

    `bench scale` says what being distributed costs; `bench realtime` finds
    the highest rate that this machine holds in real time; `bench load` plays
    several runs at once on services that are up; `bench watched` says what
    clients cost a run, `bench secured` what certificates cost a dwell,
    `bench crowd` what 100 and 300 tracks cost. Each takes some minutes.
    `bench soak` lets runs, faults, pages and questions happen at once for
    half an hour; exit code 1 if memory, descriptors, threads or disk grow, or
    a question has no answer.
    """
    console = err if as_json else out
    with command(zenoh_config=zenoh_config) as stop:
        if into and cases not in ([SCALE], [CROWD]):
            raise BadInput(f"--into {into}: belongs to `bench scale` and `bench crowd`")
        if cases and (unknown := set(cases) - set(CASES)) and not (len(cases) == 1 and cases[0] in ALONE):
            known = f"{', '.join(CASES)}; or one of {', '.join(ALONE)} alone"
            raise BadInput(f"{min(unknown)}: no such case, must be one of {known}")
        if into:
            check_page(Path(into), cases or [])  # its markers have the name of the case
        alone = {
            SCALE: lambda: _scale(console, stop, into, as_json=as_json),
            "realtime": lambda: _realtime(console, stop, as_json=as_json),
            "load": lambda: _load(
                console, stop, connect or DEFAULT_ENDPOINT, scenario, dwells, at_once, as_json=as_json
            ),
            "watched": lambda: _watched(console, stop, pairs, as_json=as_json),
            "secured": lambda: _secured(console, stop, scenario, dwells, pairs, as_json=as_json),
            CROWD: lambda: _crowd(console, stop, into, as_json=as_json),
            "soak": lambda: _soak(console, stop, minutes, as_json=as_json),
        }
        alone.get((cases or [""])[0], lambda: _cases(console, stop, cases or [], as_json=as_json))()


def _cases(console: Console, stop: Stop, cases: list[str], *, as_json: bool) -> None:
    from services import kernels
    from services.bench import cases as benchmark

    kernels.compile_all(lambda text: console.print(text, soft_wrap=True), stop)
    with progress(console) as tell:
        stop.at_once = True
        measured = benchmark.bench(cases, tell)
    if as_json:
        print_json(measured.as_json())
        return
    print_tables(out, [benchmark.table(measured)])
    for line in benchmark.remarks(measured):
        out.print(line, soft_wrap=True)


@contextmanager
def _busy(console: Console, stop: Stop) -> Iterator[Callable[[str], None]]:
    """Kernels are compiled; what goes on is shown."""
    from services import kernels

    kernels.compile_all(lambda text: console.print(text, soft_wrap=True), stop)
    with progress(console) as tell:
        yield tell


def _show(tables: Sequence[Table], document: object, *, as_json: bool) -> None:
    if as_json:
        print_json(document)
    else:
        print_tables(out, tables)


def _scale(console: Console, stop: Stop, into: str | None, *, as_json: bool) -> None:
    from services.bench import measured as page
    from services.bench.scaling import joins, runs
    from services.bench.scaling import tables as scale_tables

    with _busy(console, stop) as update:
        measured, joined = runs.measure(update, stop), joins.measure(update, stop)
    tables, remark = [*scale_tables.tables(measured), joins.table(joined)], scale_tables.remark()
    if into:
        page.write(Path(into), SCALE, tables, remark)
    _show(tables, scale_tables.as_json(measured) | {"joins": [vars(one) for one in joined]}, as_json=as_json)
    if not as_json:
        out.print(page.caption() + remark, soft_wrap=True)


def _realtime(console: Console, stop: Stop, *, as_json: bool) -> None:
    from services.bench import realtime as bench_realtime

    with _busy(console, stop) as update:
        cells = bench_realtime.bench(update, stop)
    _show([bench_realtime.table(cells)], [cell.as_json() for cell in cells], as_json=as_json)
    if not as_json:
        out.print(bench_realtime.remark(cells), soft_wrap=True)


def _load(
    console: Console, stop: Stop, connect: str, scenario: str, dwells: int, at_once: str, *, as_json: bool
) -> None:
    from services.bench import load as bench_load

    numbers = at_once.split(",")
    if not all(number.isdecimal() and 1 <= int(number) <= MAX_AT_ONCE for number in numbers):
        raise BadInput(f"--at-once {at_once}: must be numbers from 1 to {MAX_AT_ONCE}, such as 1,2,4")
    played = untold(load(scenario))
    with progress(console) as tell:
        loads = bench_load.measure(connect, played, dwells, [int(number) for number in numbers], tell, stop)
    _show([bench_load.table(loads)], bench_load.as_json(loads), as_json=as_json)


def _watched(console: Console, stop: Stop, pairs: int, *, as_json: bool) -> None:
    from services.bench import watched as bench_watched

    with _busy(console, stop) as update:
        measured = bench_watched.measure(pairs, bench_watched.DWELLS, update, stop)
    _show([bench_watched.table(measured)], bench_watched.as_json(measured), as_json=as_json)


def _secured(console: Console, stop: Stop, scenario: str, dwells: int, pairs: int, *, as_json: bool) -> None:
    from services.bench import load as bench_load

    with _busy(console, stop) as update:
        found = bench_load.secured(untold(load(scenario)), dwells, pairs, update, stop)
    _show([bench_load.table_of_secured(found)], asdict(found), as_json=as_json)


def _crowd(console: Console, stop: Stop, into: str | None, *, as_json: bool) -> None:
    from services.bench import crowd as bench_crowd
    from services.bench import measured as page

    with _busy(console, stop) as update:
        found = bench_crowd.measure(update, stop)
    if into:
        page.write(Path(into), CROWD, bench_crowd.tables(found))
    _show(bench_crowd.tables(found), bench_crowd.as_json(found), as_json=as_json)


def _soak(console: Console, stop: Stop, minutes: float, *, as_json: bool) -> None:
    from services.bench.soak import soak

    with _busy(console, stop) as update:
        found = soak.soak(minutes, 1, update, stop)
    if as_json:
        print_json(found.as_json())
    else:
        print_tables(out, [soak.table(found)])
        out.print(soak.remark(found), soft_wrap=True)
    if found.faults:
        raise RunFailed("\n".join(found.faults[:EXPLAINED]))


def verify(as_json: JsonOption = False) -> None:
    """Check this installation against theory: detector, disturbance, power allocation, beliefs. Under a minute."""
    from services import kernels
    from services.bench import verify as verification

    console = err if as_json else out
    with command() as stop:
        kernels.compile_all(lambda text: console.print(text, soft_wrap=True), stop)
        with progress(console) as tell:
            stop.at_once = True
            checks = verification.verify(tell)
    if as_json:
        print_json([check.as_json() for check in checks])
    else:
        print_tables(out, [verification.table(checks)])
    if not all(check.passed for check in checks):
        raise typer.Exit(RunFailed.exit_code)


def simulate(
    schedules: Annotated[int, typer.Option(min=1, max=100_000_000, help="How many, one seed after the other.")] = 2000,
    seed: Annotated[int, typer.Option(min=0, max=2**62, help="Of the first one.")] = 1,
    replay: Annotated[
        int | None, typer.Option(metavar="SEED", min=0, max=2**62, help="Play this one, and show its faults.")
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="JSON file that keeps what is done, to go on with."),
    ] = None,
    workers: Annotated[int, typer.Option(min=0, max=1024, help="Processes; 0: one for each core.")] = 0,
) -> None:
    """Play small runs in simulated time under faults that are drawn: of disk, network, processes and clocks.

    In lockstep each run must be what it is without faults, byte for byte; in
    real time the radar must transmit every dwell. A schedule that fails is
    shown with its seed and as few faults as it takes.
    """
    from services import kernels
    from services.campaigns.pool import n_core
    from services.simulation import trials

    with command() as stop:
        if replay is not None and store is not None:
            raise BadInput("--store: belongs to many schedules, not to --replay")
        kernels.compile_all(lambda text: out.print(text, soft_wrap=True), stop)
        if replay is not None:
            stop.at_once = True
            failed = _explain(replay)
        else:
            with progress(out) as tell:
                tally = trials.play_all(
                    *(seed, schedules),
                    workers=workers or n_core(),
                    store=store,
                    report=lambda tally: tell(f"{tally.n} schedules, {len(tally.failed)} failed"),
                    stop=stop,
                )
            stop.at_once = True
            for one in sorted(tally.failed)[:EXPLAINED]:
                _explain(one)
            failed = bool(tally.failed)
            out.print(
                f"{tally.n} schedules, {tally.faults} faults, {tally.handled} messages handled in"
                f" {tally.simulated_s / 3600.0:.1f} simulated hours: {len(tally.failed)} failed",
                soft_wrap=True,
            )
    if failed:
        raise typer.Exit(RunFailed.exit_code)


def _explain(seed: int) -> bool:
    """Show a schedule and, if it fails, why, with as few faults as that takes; whether it does."""
    from services.simulation.trials import shrunk

    outcome = shrunk(seed)
    out.print(f"{outcome.schedule}", soft_wrap=True)
    for fault in outcome.schedule.faults:
        out.print(f"  {fault}", soft_wrap=True)
    verdict = f"FAILS: {outcome.violation}" if outcome.violation else "holds"
    out.print(f"  {verdict}, {outcome.simulated_s:.1f} simulated seconds, {outcome.handled} messages", soft_wrap=True)
    return bool(outcome.violation)
