"""The commands about runs that are stored, or go on: query, export, replay, feed; and schema, of their messages."""

import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.cli import completion
from cogradar.services.cli.console import (
    DEFAULT_ENDPOINT,
    AskedOption,
    CsvOption,
    JsonOption,
    RunArgument,
    ScenarioFilter,
    SeedFilter,
    StoreOption,
    ZenohConfigOption,
    command,
    err,
    filters,
    new_file,
    newest_instead,
    out,
    print_csv,
    print_json,
    progress,
    say,
)
from cogradar.services.cli.plugins.options import PluginsOption, StrategyFilter
from cogradar.services.errors import BadInput, RunFailed, check_stop

Rows = Sequence[dict[str, Any]]

DIGEST = 12  # characters of a digest that people are shown
WIDE = 10_000  # columns of a terminal for `--wide`
NOTES = ("waiting_for", "reason")  # columns of `runs` that are sentences: lines of their own below the table
# What people read first, first; what has no room is left out from the end. Other columns follow.
ORDER = {
    "runs": ("run", "strategy", "seed", "status", "t", "dwells", "began", "digest", "scenario"),
    "tracks": ("run", "strategy", "t", "target", "detected", "share", "x_hat", "y_hat", "x", "y", "snr_db", "bin"),
    "p_d": ("scenario", "strategy", "target", "p_d", "p_d_low", "p_d_high", "in_bin", "detections", "n"),
    "rmse": ("scenario", "strategy", "target", "position_rmse_km", "velocity_rmse_km_s", "n"),
    "consistency": ("strategy", "flight", "n", "nees", "nees_position", "nees_velocity", "beyond_99", "scenario"),
    "confirmation": ("strategy", "confirmation_median_s", "confirmation_95_s", "never_found", "long_visible"),
    "summary": ("run", "target", "lost", "p_d", "p_d_low", "p_d_high", "in_bin", "outage_longest", "position_rmse_km"),
    "commands": ("n", "by", "asked", "action", "k", "state", "t", "run"),
    "antennas": ("run", "strategy", "antenna", "power", "power_max", "papr_db", "papr_max_db", "n"),
    "picture": (
        "run",
        "strategy",
        "seed",
        "gospa_km",
        "completeness",
        "spuriousness",
        "swaps",
        "tracks",
        "false_tracks",
        "blind_cells",
        "unmeasured_looks",
    ),
}


MetricArgument = Annotated[
    str,
    typer.Argument(
        help=f"{', '.join(completion.METRICS[:-1])} or {completion.METRICS[-1]}.", autocompletion=completion.metrics
    ),
]


def query(
    metric: MetricArgument,
    run_: Annotated[
        str | None, typer.Option("--run", metavar="RUN", help="This run, or all; the newest if left out.")
    ] = None,
    scenario: ScenarioFilter = None,
    strategy: StrategyFilter = None,
    seed: SeedFilter = None,
    target: Annotated[int | None, typer.Option(min=1, help="Only this target, counted from 1.")] = None,
    dwells: Annotated[str | None, typer.Option(help="First and last dwell, a:b.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Print at most this many rows.")] = None,
    offset: Annotated[int | None, typer.Option(min=0, help="Skip this many rows first.")] = None,
    connect: AskedOption = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
    store: StoreOption = None,
    columns: Annotated[str | None, typer.Option(metavar="A,B,C", help="Only these columns, in this order.")] = None,
    wide: Annotated[bool, typer.Option("--wide", help="Every column, however wide the terminal is.")] = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
) -> None:
    """Ask a running system or a store for numbers.

    Without --store and --connect, and if no system answers, it asks the newest
    store in build/ and says so.

    Columns are called as in JSON, with their units; x, y and their estimates
    x_hat, y_hat are in km, vx, vy in km/s. A table has as many of them as fit
    the terminal; $COLUMNS is its width in a pipe, too.

    The interval of p_d and summary is Wilson's, 95 %, over the dwells asked
    for as if they were independent. Dwells of one run are not: `cogradar
    campaign` and `report` give intervals over runs.
    """
    from cogradar.services.metrics import client as asking

    parameters = filters(
        run=run_,
        scenario=scenario,
        strategy=strategy,
        seed=seed,
        target=target,
        dwells=dwells,
        limit=limit,
        offset=offset,
    )
    with command(at_once=True, zenoh_config=zenoh_config):
        if as_json and as_csv:
            raise BadInput("--json and --csv: one of them")
        if metric not in completion.METRICS:
            raise BadInput(f"metric = {metric!r}: must be one of {', '.join(completion.METRICS)}")
        with asking.source(store, connect, partial(newest_instead, connect)) as ask:
            rows = ask(metric, parameters)
        if columns is not None:
            rows = _only(rows, columns.split(","))
    if as_json:
        print_json(rows)
    elif as_csv:
        print_csv(rows)
    else:
        _show(rows, metric, chosen=columns is not None, wide=wide)


def _show(rows: Rows, metric: str, *, chosen: bool, wide: bool) -> None:
    """Print an answer as a table, of all columns if they were `chosen`, and what is said below it."""
    from cogradar.services.cli.display import NO_ROWS
    from cogradar.services.cli.terminal import print_tables

    order = () if chosen else ORDER[metric]
    remedy = "; --wide or --columns NAME,... shows them"
    print_tables(out, [rows_table(rows, order, wide=wide)], WIDE if wide else None, remedy)
    if not rows:
        say(NO_ROWS.get(metric, ""))
    if metric == "tracks":
        say("x, y in km, vx, vy in km/s; hat: estimates")
    for row in rows if not (chosen or wide) else ():
        if note := row.get("reason") or row.get("waiting_for"):
            stopped = "stopped " if row.get("status") == "stopped" else ""
            of = f"{row['run']}, {row['n']}" if metric == "commands" else row["run"]
            say(f"{of}: {stopped}{note}")


def export(
    file: Annotated[
        str,
        typer.Option("--out", metavar="FILE", callback=new_file, help="File to write; -: a table to standard output."),
    ],
    run_: RunArgument = None,
    store: StoreOption = None,
    connect: AskedOption = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
    form: Annotated[
        str | None,
        typer.Option(
            "--format", help="csv, json, npz, parquet, mat, nc, mcap, rrd or gif; by the suffix of FILE if left out."
        ),
    ] = None,
    what: Annotated[
        str | None,
        typer.Option(
            "--what",
            help="scores: truth beside estimates, a row per dwell and target; tracks: estimates with covariances;"
            " detections, looks, requests, truth, waveforms: a row each;"
            " run: everything (mcap, rrd); clip: a moving picture (gif). The first that the format can hold.",
        ),
    ] = None,
    dwells: Annotated[str | None, typer.Option(help="First and last dwell, a:b; of all formats.")] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=1.0, max=50.0, metavar="HZ", help="Dwells per second of a clip; 10 if left out."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE if it is there.")] = False,
) -> None:
    """Write a run into one file: a table, the whole run for a viewer, or a GIF.

    Columns are called as in `query`: x and y are in km, vx and vy in km/s,
    others have their units in their names. Angles are from boresight, nu is
    0.5 sin(angle). Estimates have "hat" in their names, those
    without are the target's. In Python the same is numpy.load, pandas.read_csv
    or read_parquet, xarray.open_dataset; in MATLAB and Octave it is load. An
    mcap file opens in Foxglove and Lichtblick, an rrd file in rerun.
    """
    from cogradar.services.analysis.arrays.result import Result
    from cogradar.services.analysis.export import formats
    from cogradar.services.analysis.stored_run import StoredRun
    from cogradar.services.metrics import client as asking
    from cogradar.services.metrics.selection import dwells_of

    instead = partial(newest_instead, connect)
    with command(at_once=True, zenoh_config=zenoh_config), asking.source(store, connect, instead) as ask:
        result, among = Result(StoredRun(ask, run_)), dwells_of(dwells or ":")
        if file == "-":
            formats.send(result, sys.stdout.buffer, form, what, formats.Options(among, rate))
            return
        with progress(err) as show:
            how = formats.Options(among, rate, lambda n: show(f"{n} dwells written"))
            written = formats.write(result, Path(file), form, what, force=force, options=how)
        out.print(f"{file}: {result.run}, {written}", soft_wrap=True)


def replay(
    to: Annotated[
        Literal["planner", "allocator"],
        typer.Option("--to", metavar="CORE", show_choices=False, help="planner or allocator."),
    ],
    run_: RunArgument = None,
    store: StoreOption = None,
    connect: AskedOption = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
    _plugins: PluginsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Feed a stored run into one core, and compare its answers bit for bit.

    The exit code is 1 if an answer differs; the first difference is printed.
    After a change of a planner this shows the first dwell in which it decides
    otherwise.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from cogradar.services.analysis import replay as replaying
    from cogradar.services.analysis.stored_run import StoredRun
    from cogradar.services.metrics import client as asking

    columns = (TextColumn("dwells"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with (
        command(at_once=True, zenoh_config=zenoh_config),
        asking.source(store, connect, partial(newest_instead, connect)) as ask,
        Progress(*columns, console=err, transient=True) as progress,
    ):
        stored = StoredRun(ask, run_)
        if run_ is None:
            say(f"{stored.name}: the newest run, and no other", err)
        task = progress.add_task("", total=stored.row["k"])
        outcome = replaying.replay(stored, to, lambda done: progress.update(task, completed=done))
    if as_json:
        print_json({"run": stored.name, **asdict(outcome)})
    else:
        for line in replaying.words(stored.name, to, outcome):
            out.print(line, soft_wrap=True)
    if outcome.difference is not None:
        raise typer.Exit(RunFailed.exit_code)


def feed(
    to: Annotated[
        str,
        typer.Option(
            "--to", metavar="FORMAT", help="aircraft-json, asterix, cot, geojson, sapient, or your own: PATH.py:NAME."
        ),
    ],
    where: Annotated[
        str,
        typer.Option(
            "--out", metavar="WHERE", help="udp://HOST:PORT, tcp://HOST:PORT, a folder, or -: standard output."
        ),
    ],
    run_: RunArgument = None,
    store: StoreOption = None,
    connect: AskedOption = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
    rate: Annotated[
        float,
        typer.Option(
            min=0.0, max=1000.0, metavar="HZ", help="Most pictures per second, the newest ones; 0: every dwell."
        ),
    ] = 10.0,
    speed: Annotated[
        float, typer.Option(min=0.0, max=1e6, help="With --store: so many times as fast as the run; 0: at once.")
    ] = 1.0,
    tentative: Annotated[bool, typer.Option("--tentative", help="Tracks that are not confirmed, too.")] = False,
    stale: Annotated[
        float, typer.Option(min=0.1, max=86_400.0, help="Cursor on Target: seconds that an event holds.")
    ] = 10.0,
    sac: Annotated[int, typer.Option(min=0, max=255, help="ASTERIX: code of the area of the system.")] = 0,
    sic: Annotated[int, typer.Option(min=0, max=255, help="ASTERIX: code of the system.")] = 1,
    site: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON,HEIGHT,BEARING",
            help="Where the radar stands and looks, degrees and m, in place of the scenario's `site`.",
        ),
    ] = None,
    categories: Annotated[
        str, typer.Option(metavar="A,B", help="ASTERIX: 034 the radar, 048 its plots and tracks, 062 tracks.")
    ] = "034,062",
    tasks: Annotated[
        bool, typer.Option("--tasks", help="SAPIENT: command the run as tasks ask, with a commander's certificate.")
    ] = False,
) -> None:
    """Send the tracks of a run to other systems: maps, displays, control centres.

    Without RUN it follows the newest run, and later ones, until Ctrl-C. Each
    picture has all tracks, so that a display which joins late is complete
    after one dwell; at the end all tracks are dropped. The scenario's
    table `site` says where the radar stands, or else --site does.
    """
    from cogradar.services.feed import feed as feeding
    from cogradar.services.feed.asterix import Source
    from cogradar.services.feed.picture import Wanted
    from cogradar.services.feed.sapient.tasking import Commander
    from cogradar.services.feed.source import live, recorded, site_from
    from cogradar.services.metrics import client as asking

    with command(zenoh_config=zenoh_config) as stop, ExitStack() as opened:
        kind, check, notify = feeding.kind_of(to), partial(check_stop, stop), partial(say, console=err)
        if tasks and (store is not None or not kind.takes_tasks):
            raise BadInput("--tasks: only --to sapient takes them, of a run that goes on")
        commander = opened.enter_context(closing(Commander(connect))) if tasks else None
        form = kind.make(feeding.Options(Source(sac, sic), categories, stale, commander, notify))
        way, tally = kind.way(where, form, notify), feeding.Tally()
        try:
            wanted = Wanted(tentative, form.wants_plots, None if site is None else site_from(site))
            if store is None:
                feeding.feed(live(connect, run_, check, notify, wanted), form, way, rate, tally)
            else:
                with asking.source(store, connect) as ask:
                    pictures = recorded(ask, run_, speed, check, wanted)
                    feeding.feed(pictures, form, way, rate if speed else 0.0, tally)
        finally:
            way.close()
            if tally.offered:
                notify(tally.words(way))
        if not tally.sent:
            cure = "start the receiver first, then the feed" if tally.offered else "it has no pictures"
            raise RunFailed(f"nothing of the run was sent: {cure}")


def schema(
    form: Annotated[
        Literal["asyncapi", "jsonschema"],
        typer.Option(
            "--format", help="asyncapi: keys, senders, readers, rights, messages; jsonschema: the messages alone."
        ),
    ] = "asyncapi",
    file: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", callback=new_file, help="The file to write; printed if left out."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE if it is there.")] = False,
) -> None:
    """Describe all messages, for programs in other languages."""
    with command(at_once=True):
        from cogradar.services.analysis.export.whole import whole
        from cogradar.shared.wire.contract import asyncapi, json_schema

        text = json.dumps((asyncapi if form == "asyncapi" else json_schema).document(), indent=2) + "\n"
        if file is not None:
            with whole(file, force=force) as part:
                part.write_text(text, encoding="utf-8")
    if file is None:
        sys.stdout.write(text)
    else:
        say(f"{file}: {form}")


def _only(rows: Rows, names: Sequence[str]) -> list[dict[str, Any]]:
    """The rows with these columns. Raises BadInput."""
    for name in names:
        if rows and name not in rows[0]:
            raise BadInput(f"--columns: there is no {name!r}, must be some of {','.join(rows[0])}")
    return [{name: row[name] for name in names} for row in rows]


def rows_table(rows: Rows, order: Sequence[str] = (), *, wide: bool = False) -> Table:
    """Any answer of metrics as a table; headings are the keys that JSON has, the ones of `order` first."""
    columns, hidden = [], () if wide or not order else NOTES
    for key in sorted(rows[0], key=lambda key: order.index(key) if key in order else len(order)) if rows else ():
        if key in hidden:
            continue
        values = [row[key] for row in rows]
        form = ":.4g" if any(isinstance(value, float) for value in values) else ""
        if key == "digest" and not wide:
            form = f":.{DIGEST}"
        columns.append(Column(key, f"{{{key}{form}}}", left=any(isinstance(value, str) for value in values)))
    return Table("", columns, rows)
