"""The command line. Exit codes: 0 done, 1 failed, 2 bad input, 3 no metrics service, 130/143 interrupted. Of a
service: 4 another one took its role over, 5 the router does not hear it any more."""

import sys
import uuid
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from cogradar.services.cli import answers as cli_answers
from cogradar.services.cli import bench as cli_bench
from cogradar.services.cli import calibrate as cli_calibrate
from cogradar.services.cli import campaigns as cli_campaigns
from cogradar.services.cli import certs as cli_certs
from cogradar.services.cli import completion
from cogradar.services.cli import runs as cli_runs
from cogradar.services.cli.console import (
    DEFAULT_ENDPOINT,
    ConnectOption,
    JsonOption,
    ServiceFrontEndOption,
    ServiceStoreOption,
    SetOption,
    ZenohConfigOption,
    call,
    command,
    endpoints,
    new_file,
    number_of_dwells,
    out,
    print_json,
    say,
)
from cogradar.services.cli.manual import examples
from cogradar.services.cli.plugins import commands as cli_plugins
from cogradar.services.cli.plugins.options import PluginsOption
from cogradar.services.cli.stores import commands as cli_stores
from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.runs.run import untold
from cogradar.services.topology import Start
from cogradar.shared.protocol.fields import MAX_RATE_HZ
from cogradar.shared.protocol.slots import fault_of_name
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.document import read
from cogradar.shared.scenario.faults import printable_lines
from cogradar.shared.scenario.files import ScenarioError, built_in, load, written
from cogradar.shared.scenario.limits import UNLIMITED, said_dwells
from cogradar.shared.scenario.plugins.resolver import load_for
from cogradar.shared.scenario.scenario import Scenario

app = typer.Typer(
    name="cogradar",
    help="A cognitive radar in simulation: POMCP planning and max-min power allocation in closed loop, over Zenoh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Entry point."""
    call(app)


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
    """Options that come before a command."""


def service(
    role: Annotated[Role, typer.Argument(metavar="ROLE", show_choices=False, help=f"One of {', '.join(Role)}.")],
    connect: ConnectOption = DEFAULT_ENDPOINT,
    listen: Annotated[
        str,
        typer.Option(
            envvar="COGRADAR_LISTEN",
            callback=endpoints,
            help="Where a router listens; tcp/0.0.0.0:7447: for other machines, too.",
        ),
    ] = DEFAULT_ENDPOINT,
    zenoh_config: ZenohConfigOption = None,
    allow: Annotated[
        str | None,
        typer.Option(
            envvar="COGRADAR_ALLOW",
            metavar="FILE",
            help="Router: let in the certificates with these names, a name a line, each for its role's part.",
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            help="Unique name of this process; random if left out, and the certificate's if it has one. A planner"
            " named [NAME]@FIRST-LAST plans for these of 16 slots of tracks only."
        ),
    ] = None,
    store: ServiceStoreOption = "cogradar.db",
    resume: Annotated[
        bool, typer.Option(help="Recorder: go on with the unfinished runs of its store, or give them up.")
    ] = True,
    keep_runs: Annotated[
        int | None,
        typer.Option(envvar="COGRADAR_KEEP_RUNS", min=1, help="Recorder: ended runs to keep; all if left out."),
    ] = None,
    keep_days: Annotated[
        float | None,
        typer.Option(envvar="COGRADAR_KEEP_DAYS", min=0.0, help="Recorder: days to keep them; for ever if left out."),
    ] = None,
    keep_hours: Annotated[
        float | None,
        typer.Option(
            envvar="COGRADAR_KEEP_HOURS",
            min=0.0,
            help="Recorder: hours to keep of a run without an end, by its own clock; as many as --keep-bytes allows if"
            " left out.",
        ),
    ] = None,
    keep_bytes: Annotated[
        int | None,
        typer.Option(
            envvar="COGRADAR_KEEP_BYTES",
            min=1_000_000,
            help="Recorder: bytes to keep of the messages of a run without an end; 4 GB if left out.",
        ),
    ] = None,
    front_end: ServiceFrontEndOption = Start.front_end,
    scenario: Annotated[
        str,
        typer.Option(
            envvar="COGRADAR_SCENARIO",
            autocompletion=completion.scenarios,
            help="Operator: run this scenario, seed after seed; empty: no runs.",
        ),
    ] = "",
    settings: SetOption = None,
    dwells: Annotated[
        int | None,
        typer.Option(
            envvar="COGRADAR_DWELLS",
            metavar=f"N|{UNLIMITED}",
            parser=number_of_dwells,
            help=f"Operator: of a run, instead of the scenario's number; {UNLIMITED}: until it is ended.",
        ),
    ] = None,
    rate: Annotated[
        float,
        typer.Option(
            envvar="COGRADAR_RATE", min=0.001, max=MAX_RATE_HZ, metavar="HZ", help="Operator: dwells per second."
        ),
    ] = 10.0,
    http: Annotated[
        str,
        typer.Option(metavar="HOST:PORT", help="Metrics: serve HTTP there, or at the next free port."),
    ] = "",
    _plugins: PluginsOption = None,
    with_parent: Annotated[bool, typer.Option("--with-parent", hidden=True)] = False,
) -> None:
    """Run one process of the system until SIGTERM."""
    from cogradar.services import process

    made_up = f"{role}-{uuid.uuid4().hex[:8]}"
    full_name = made_up if name is None else made_up + name if name.startswith("@") else name
    if fault := fault_of_name(full_name, role):
        raise typer.BadParameter(f"{name!r}: {fault}", param_hint="--name")
    with command(zenoh_config=zenoh_config) as stop:
        if with_parent:
            process.stop_with_parent(stop)
        played = untold(load(scenario, settings or ())) if role is Role.OPERATOR and scenario else None
        if played is not None and dwells is not None:
            played = played.model_copy(update={"dwells": dwells})
        start = Start(
            full_name,
            store,
            resume,
            keep_runs,
            keep_days,
            keep_hours,
            keep_bytes,
            not with_parent,
            front_end,
            played,
            rate,
            http,
        )
        process.be(role, start, connect=connect, listen=listen, stop=stop, allow=allow)
    process.leave()


def scenarios(
    show: Annotated[
        str | None,
        typer.Option(help="Print this scenario as a complete file.", autocompletion=completion.scenarios),
    ] = None,
    settings: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the built-in scenarios; --show prints one, or a file, with every key."""
    with command(at_once=True):
        if show:
            shown = _loaded(show, settings)
        elif settings:
            raise BadInput("--set: belongs to --show")
    if show and as_json:
        print_json(shown.model_dump(mode="json"))
    elif show:
        sys.stdout.write(printable_lines(written(shown, read(show).files)))
    else:
        found = {name: load(name).title for name in built_in()}
        if as_json:
            print_json(found)
            return
        for name, title in found.items():
            out.print(f"{name:13} {title}", soft_wrap=True)


def sky(
    file: Annotated[
        Path,
        typer.Option("--out", callback=new_file, help="FILE.toml, a scenario, or FILE.csv, generated positions."),
    ],
    aircraft: Annotated[
        str | None,
        typer.Option(
            metavar="N|NAME,NAME",
            help="How many, 12 if left out; of a recording the N longest in view, or those with these addresses or"
            " callsigns; all if left out.",
        ),
    ] = None,
    minutes: Annotated[
        int | None,
        typer.Option(min=1, max=600, help="Length: 20 if left out; of a recording, all from --start on."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**64 - 1, help="Seed of the generated sky.")] = 1,
    positions: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="A recording, or a folder of them: CSV with time, aircraft, latitude, longitude; JSON of readsb,"
            " tar1090 or OpenSky; Parquet; ASTERIX, also as a capture of packets.",
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="UTC", help="Of a recording: positions from then on, such as 2024-05-01T12:00:00Z."),
    ] = None,
    ground: Annotated[
        bool, typer.Option("--ground", help="Of a recording: keep aircraft while they are on the ground.")
    ] = False,
    origin: Annotated[
        str | None, typer.Option(metavar="LAT,LON", help="Where the radar is, degrees; with --from or FILE.csv.")
    ] = None,
    boresight: Annotated[
        float, typer.Option(min=0.0, max=360.0, metavar="DEG", help="Boresight of the radar, clockwise from north.")
    ] = 0.0,
    range_km: Annotated[
        float, typer.Option("--range", min=20.0, max=1000.0, metavar="KM", help="Aircraft up to this range.")
    ] = 100.0,
    heights: Annotated[
        bool, typer.Option("--heights", help="Aircraft of a recording have their altitudes; else all are at height 0.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a scenario of a whole sky: invented traffic, or the aircraft of a recording."""
    with command(at_once=True):
        from cogradar.services.skies import make

        asked = make.Asked(
            aircraft, minutes, seed, positions, origin, boresight, range_km, heights, start=start, ground=ground
        )
        made = make.write(asked, file, force=force)
    if as_json:
        print_json(made.document)
        return
    if made.tally is not None:
        from cogradar.services.cli.display import recording_table
        from cogradar.services.cli.terminal import print_tables

        print_tables(out, [recording_table(made.tally)])
        for line in made.tally.lines:
            if more := "; ".join(text for text in (line["example"], line["cure"]) if text):
                say(f"{line['why']}: {more}")
        for note in made.tally.notes:
            say(f"note: {note}", style="yellow")
    say(f"{file}: {made.said}")


def check(
    file: Annotated[
        str,
        typer.Argument(
            help="A scenario; or of your own FILE.py, FILE.py:NAME or package.module:NAME.",
            autocompletion=completion.checked,
        ),
    ],
    settings: SetOption = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 if there is a warning.")] = False,
    kind: Annotated[
        str | None,
        typer.Option(help="Kind of FILE.py:NAME, if the file leaves it open.", autocompletion=completion.kinds),
    ] = None,
    _plugins: PluginsOption = None,
) -> None:
    """Check a scenario or a plug-in of your own, and name every fault.

    For a scenario it prints the SNR of its targets, and warns of settings
    that make no sense. For a rule, a strategy, an objective or a disturbance
    it prints whether its answers make sense and are the same each time, and
    what a call costs.
    """
    if cli_plugins.is_of_author(file):
        cli_plugins.check_own(file, kind)
        return
    with command(at_once=True):
        loaded = _loaded(file, settings)
        load_for("", loaded.radar.model_dump(), "", None if loaded.world is None else loaded.world.model_dump())
    from cogradar.services.kernels import interpret_unless_compiled

    interpret_unless_compiled()  # before what follows imports some
    from cogradar.services.cli.display import check_table
    from cogradar.services.cli.terminal import print_tables
    from cogradar.shared.scoring.prospects import prospects, warnings

    radar = loaded.radar
    there = len(loaded.starting)
    later = f", {there} of them there at the start" if loaded.world is not None and loaded.n_target > there else ""
    targets = f"{loaded.n_target} target{'s' if loaded.n_target != 1 else ''}{later}"
    out.print(f"{file}: valid, {targets}, {said_dwells(loaded.dwells)} dwells, {radar.fidelity}", soft_wrap=True)
    expected = prospects(loaded) if loaded.world is not None else []
    if loaded.world is not None:
        print_tables(out, [check_table(expected)])
        say(
            "SNR: of one virtual channel over the disturbance's mean level. Array: after the gain of all of them, with"
            " all power on this target. Disturbance: its level towards the target, relative to the mean, which the"
            " detector has to beat as well. "
            + (
                "P_D: to be expected at the start with each strategy's power, if every track asks for its target's bin"
                if radar.search is None
                else "P_D search: of a look of the search while it has all power, where the target begins; seen after:"
                " the time until the first detection to be expected then. Tracks take up to nine tenths of the power"
            )
        )
    found = warnings(loaded, expected)
    for text in found:
        say(f"warning: {text}", style="yellow")
    if found and strict:
        raise typer.Exit(RunFailed.exit_code)


def _loaded(file: str, settings: list[str] | None) -> Scenario:
    """A scenario; raises BadInput with a line for every fault."""
    try:
        return load(file, settings or ())
    except ScenarioError as error:
        raise BadInput("\n".join(error.faults)) from None


FUNCTIONS: dict[str, Callable[..., None]] = {
    "run": cli_runs.run,
    "scenarios": scenarios,
    "sky": sky,
    "check": check,
    "new": cli_plugins.new,
    "command": cli_runs.command_run,
    "cancel": cli_runs.cancel,
    "query": cli_answers.query,
    "export": cli_answers.export,
    "figures": cli_campaigns.figures,
    "feed": cli_answers.feed,
    "replay": cli_answers.replay,
    "campaign": cli_campaigns.campaign,
    "sweep": cli_campaigns.sweep,
    "report": cli_campaigns.report,
    "store": cli_stores.store_command,
    "certs": cli_certs.certs,
    "service": service,
    "schema": cli_answers.schema,
    "calibrate": cli_calibrate.calibrate,
    "verify": cli_bench.verify,
    "chaos": cli_bench.chaos,
    "simulate": cli_bench.simulate,
}
for name, function in FUNCTIONS.items():
    settings = {"ignore_unknown_options": True} if name == "command" else None  # -20 is a bearing
    panel = examples.COMMANDS[name].panel
    app.command(name, rich_help_panel=panel, epilog=examples.epilog(name), context_settings=settings)(function)
app.add_typer(cli_bench.bench, rich_help_panel=examples.COMMANDS["bench"].panel, epilog=examples.epilog("bench"))
