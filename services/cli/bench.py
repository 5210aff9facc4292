"""The commands about this installation: bench, verify, simulate and chaos."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from cogradar.services.cli.console import (
    MAX_KILLS,
    JsonOption,
    Pace,
    RateOption,
    ScenarioArgument,
    SetOption,
    command,
    err,
    new_file,
    out,
    print_json,
    progress,
    rate_of,
)
from cogradar.services.cli.terminal import print_tables
from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.runs.run import as_played, untold
from cogradar.services.topology import Start
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

# As in cogradar.services.bench.kernels, which is too slow to import for a line of help.
KERNELS = (
    *("pomcp_literal", "pomcp", "exact", "mode", "mean", "belief_resample", "belief_rejection"),
    *(
        "predict_mixture",
        "weigh_looks",
        "regularise_looks",
        "assign_1000",
        "directions",
        "cell",
        "array_dwell",
        "array_ranges",
        "array_echoes",
        "monopulse",
        "sky_dwell",
        "plan_message",
    ),
    *("allocate_3", "allocate_10", "allocate_30", "allocate_100", "allocate_equal_12"),
    *("joint_3", "joint_12", "joint_100"),
    *("urgency_100", "wide_12"),
)
DWELL = ("scores", "dwell_in_process", "dwell_zenoh")
EXPLAINED = 10  # failing schedules

bench = typer.Typer(
    name="bench",
    help="Time this installation: medians of many repeats, beside the goals and past figures.",
    no_args_is_help=True,
)
UpdateOption = Annotated[bool, typer.Option("--update", help="Write the medians as the figures to compare with.")]


@bench.command()
def kernels(
    cases: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CASE]...",
            autocompletion=lambda incomplete: [name for name in KERNELS if name.startswith(incomplete)],
            help=f"Only these cases, of {', '.join(KERNELS)}. All cases if left out.",
        ),
    ] = None,
    update: UpdateOption = False,
    as_json: JsonOption = False,
) -> None:
    """Time the kernels; cases that are more than 5 % slower than their past figures are named."""
    with command():
        if unknown := set(cases or ()) - set(KERNELS):
            raise BadInput(f"CASE {min(unknown)}: must be one of {', '.join(KERNELS)}")
    _time(cases or KERNELS, update=update, as_json=as_json)


@bench.command()
def dwell(update: UpdateOption = False, as_json: JsonOption = False) -> None:
    """Time a whole dwell of three targets, in one process and over Zenoh, and its scores."""
    _time(DWELL, update=update, as_json=as_json)


@bench.command()
def feed(
    tracks: Annotated[int, typer.Option(min=1, max=100_000, help="Tracks of a picture.")] = 1000,
    as_json: JsonOption = False,
) -> None:
    """Time what a feed takes of a core: pictures of a dwell's messages, and packing them in each format."""
    from cogradar.services.feed import cost

    with command() as stop, progress(err if as_json else out) as tell:
        stop.at_once = True
        costs = cost.measure(tracks, 20, tell)
    if as_json:
        print_json([cost.row(one) for one in costs])
    else:
        print_tables(out, [cost.table(costs)])


@bench.command()
def front_end(as_json: JsonOption = False) -> None:
    """Time a dwell at the built-in front end, at one in Python and at a process that is asked over Zenoh."""
    from cogradar.services.bench import front_ends
    from cogradar.services.kernels import compile_all

    console = err if as_json else out
    with command() as stop:
        compile_all(lambda text: console.print(text, soft_wrap=True), stop)
        with progress(console) as tell:
            stop.at_once = True
            costs = front_ends.measure(tell)
    if as_json:
        print_json([front_ends.row(one) for one in costs])
    else:
        print_tables(out, [front_ends.table(costs)])


def _time(cases: Sequence[str], *, update: bool, as_json: bool) -> None:
    from cogradar.services.bench import figures
    from cogradar.services.bench import kernels as benchmark
    from cogradar.services.kernels import compile_all

    console = err if as_json else out
    with command() as stop:
        past = figures.read()
        compile_all(lambda text: console.print(text, soft_wrap=True), stop)
        with progress(console) as tell:
            stop.at_once = True
            measured = benchmark.bench(cases, tell)
        if update:
            figures.write(measured)
    if as_json:
        print_json(measured.as_json() | {"slower": figures.slower(measured, past)})
        return
    print_tables(out, [benchmark.table(measured)])
    for line in [*benchmark.remarks(measured), *figures.remarks(measured, past)]:
        out.print(line, soft_wrap=True)


def verify(as_json: JsonOption = False) -> None:
    """Check this installation against theory: detector, disturbance, power allocation, beliefs. Under a minute.

    A short run must also come to the digest that it has on every machine.
    """
    from cogradar.services import kernels
    from cogradar.services.bench import golden
    from cogradar.services.bench import verify as verification

    console = err if as_json else out
    with command() as stop:
        kernels.compile_all(lambda text: console.print(text, soft_wrap=True), stop)
        with progress(console, each_s=0.0) as tell:
            stop.at_once = True
            checks = verification.verify(tell)
            digest = golden.digest()
    if as_json:
        print_json([*(check.as_json() for check in checks), digest.as_json()])
    else:
        print_tables(out, [verification.table(checks)])
        out.print(str(digest), soft_wrap=True)
    if not (all(check.passed for check in checks) and digest.passed):
        raise typer.Exit(RunFailed.exit_code)


def simulate(
    schedules: Annotated[int, typer.Option(min=1, max=100_000_000, help="Number of schedules, by seed.")] = 2000,
    seed: Annotated[int, typer.Option(min=0, max=2**62, help="Seed of the first schedule.")] = 1,
    replay: Annotated[
        int | None,
        typer.Option(metavar="SEED", min=0, max=2**62, help="Repeat the schedule of this seed; show its faults."),
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(metavar="FILE", callback=new_file, help="JSON file that keeps what is done, to go on with."),
    ] = None,
    workers: Annotated[int, typer.Option(min=0, max=1024, help="Processes; 0: one for each core.")] = 0,
) -> None:
    """Run small systems in simulated time under random faults of disk, network, processes and clocks.

    In lockstep each run must equal the run without faults byte for byte; in
    real time the radar must transmit every dwell. A schedule that fails is
    shown with its seed and the fewest faults that cause it.
    """
    from cogradar.services import kernels
    from cogradar.services.campaigns.pool import n_core
    from cogradar.services.simulation import trials

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
    from cogradar.services.simulation.trials import shrunk

    outcome = shrunk(seed)
    out.print(f"{outcome.schedule}", soft_wrap=True)
    for fault in (*outcome.schedule.commands, *outcome.schedule.faults):
        out.print(f"  {fault}", soft_wrap=True)
    verdict = f"FAILS: {outcome.violation}" if outcome.violation else "holds"
    out.print(f"  {verdict}, {outcome.simulated_s:.1f} simulated seconds, {outcome.handled} messages", soft_wrap=True)
    return bool(outcome.violation)


def chaos(
    scenario: ScenarioArgument = "smoke",
    runs: Annotated[int, typer.Option(min=1, max=10_000, help="Seeds 1 to this.")] = 20,
    dwells: Annotated[int, typer.Option(min=1, max=1_000_000, help="Dwells of each run.")] = 1000,
    settings: SetOption = None,
    planners: Annotated[int, typer.Option(min=1, max=64, help="Planner processes.")] = 3,
    pool: Annotated[int, typer.Option(min=1, max=16, help="Emulators, and allocators.")] = 1,
    kills: Annotated[
        float, typer.Option(min=0.001, max=MAX_KILLS, metavar="PER_MINUTE", help="Processes killed per minute.")
    ] = 20.0,
    pace: Annotated[Pace, typer.Option(help="In lockstep digests must be equal, in real time no track may end.")] = (
        Pace.LOCKSTEP
    ),
    rate: RateOption = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            callback=new_file,
            help="In real time: when what was killed, and what tracks did; CSV.",
        ),
    ] = None,
) -> None:
    """Kill processes of running systems at random, and check their runs.

    In lockstep each must have the digest of the undisturbed run. In
    real time no track may end because of a process; the longest time without
    a plan of a confirmed track is printed.
    """
    from cogradar.services import kernels
    from cogradar.services.cli.display import RunDisplay
    from cogradar.services.runs.chaos import all_together, timeline, trial, trial_in_real_time
    from cogradar.services.runs.launcher import LocalProcesses

    given = LocalProcesses(planners, pool=pool)
    killed, failed, seen = 0, 0, []
    with command() as stop:
        loaded = untold(as_played(load(scenario, settings or ()), Start.front_end))
        rate_hz = rate_of(loaded, pace, rate)
        if file is not None and rate_hz == 0.0:
            raise BadInput("--out: only with --pace realtime; in lockstep kills take no time of a run")
        _write_timeline(file, ())  # what cannot be written is said before the runs
        with RunDisplay(out, dwells) as display:
            kernels.compile_all(display.notify, stop)
            for seed in range(1, runs + 1):
                start = RunStart.of(loaded, Strategy.POWER_AWARE, seed, dwells, rate_hz)
                if rate_hz > 0.0:
                    seen.append(trial_in_real_time(start, given, kills, report=display.report, stop=stop))
                    failed += not seen[-1].holds
                    _write_timeline(file, timeline(seen))
                    display.notify(f"seed {seed}: {seen[-1]}")
                    continue
                tried = trial(start, given, kills, report=display.report, stop=stop)
                killed, failed = killed + tried.killed, failed + (not tried.same)
                verdict = "same digest" if tried.same else f"DIFFERS: {tried.digest}, expected {tried.expected}"
                display.notify(f"seed {seed}: {tried.killed} processes killed, {tried.elapsed_s:.1f} s, {verdict}")
        in_peace = f"{runs} runs, {killed} processes killed, {failed} runs differ from those left in peace"
        out.print(all_together(seen) if seen else in_peace, soft_wrap=True)
    if failed:
        raise typer.Exit(RunFailed.exit_code)


def _write_timeline(file: Path | None, rows: Iterable[tuple[int, str, str, float, float]]) -> None:
    from cogradar.services.analysis.export.whole import whole
    from cogradar.services.analysis.pages import as_csv

    if file is not None:
        texts = [[str(seed), what, which, f"{first:.5g}", f"{last:.5g}"] for seed, what, which, first, last in rows]
        with whole(file, force=True) as part:
            part.write_text(as_csv(("seed", "what", "of", "first dwell", "last dwell"), texts), encoding="utf-8")
