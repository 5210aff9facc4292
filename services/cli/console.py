"""What all commands share: the two consoles, their options, how a command ends, how a stop is noticed."""

import csv
import errno
import io
import json
import os
import signal
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.text import Text

from cogradar.services.analysis.export.whole import fault_of_file, fault_of_folder
from cogradar.services.certs import endpoints as written
from cogradar.services.cli import completion
from cogradar.services.errors import BadInput, Failure, Interrupted, RunFailed, SignalEvent
from cogradar.services.recorder.store.address import SHORT, unsaid
from cogradar.shared.protocol.fields import MAX_RATE_HZ
from cogradar.shared.scenario.faults import allowed, printable, printable_lines
from cogradar.shared.scenario.files import ScenarioError
from cogradar.shared.scenario.limits import MAX_DWELLS, NO_END, UNLIMITED
from cogradar.shared.scenario.plugins.kinds import RULE
from cogradar.shared.scenario.plugins.names import PluginError, names_of
from cogradar.shared.scenario.scenario import Scenario

_UNWRITTEN = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
MAX_KILLS = 120.0  # of processes, a minute; with more they would hardly be up

# A path or a reason is shown as it is: [brackets] are no markup, :names: no pictures.


class _Printable(Console):
    """Prints text that others have written: names, reasons, paths, lines of files. It holds no control characters."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print, as `rich.console.Console` has it."""
        super().print(*(_shown(one) for one in objects), **options)


def _shown(text: Any) -> Any:
    if isinstance(text, Text):
        text = text.copy()
        text.plain = printable_lines(text.plain)
    return printable_lines(text) if isinstance(text, str) else text


out = _Printable(markup=False, emoji=False, highlight=False)
err = _Printable(markup=False, emoji=False, highlight=False, stderr=True)

DEFAULT_ENDPOINT = written.DEFAULT
CONNECT_VARIABLE = "COGRADAR_CONNECT"
BUILD = "build"  # folder in which `make` keeps runs
CONFIG_VARIABLE = "COGRADAR_ZENOH"  # as in cogradar.shared.wire.session, which is too slow to import for a line of help


def endpoints(text: str | None) -> str | None:
    """One or several endpoints of routers, as they were given. Raises BadParameter for anything else."""
    if text is not None and (fault := written.fault_of(text)):
        raise typer.BadParameter(fault)
    return text


def new_file(given: str | Path | None) -> str | Path | None:
    """A file to write. Raises BadParameter for one that cannot be."""
    if given is not None and (fault := fault_of_file(given)):
        raise typer.BadParameter(fault)
    return given


def page(given: str | None) -> str | None:
    """A page to write into. Raises BadParameter unless it is there."""
    new_file(given)
    if given is not None and not Path(given).is_file():
        raise typer.BadParameter(f"{given}: there is no such file: name a page with the markers of the tables")
    return given


def new_folder(given: str | None) -> str | None:
    """A folder to write into, which may not be there yet. Raises BadParameter for one that cannot be."""
    if given is not None and (fault := fault_of_folder(given)):
        raise typer.BadParameter(fault)
    return given


def one_source(context: typer.Context, option: typer.CallbackParam, text: str | None) -> str | None:
    """A store or an endpoint, of which a command line has only one. Raises BadParameter."""
    sources = [context.get_parameter_source(name) for name in ("store", "connect")]
    if all(source is not None and source.name == "COMMANDLINE" for source in sources):
        raise typer.BadParameter("--store reads a store, --connect asks services: one of them")
    return endpoints(text) if option.name == "connect" else text


def newest_store() -> str | None:
    """The store in build/ that was written last, as `make run` and `make watch` leave one; None if there is none."""
    found = [path for path in Path(BUILD).glob("*.db") if path.is_file()]
    return str(max(found, key=lambda path: path.stat().st_mtime)) if found else None


def newest_instead(connect: str) -> str | None:
    """The newest store in build/, which is said. None: there is none, or `connect` is not the default."""
    found = newest_store() if connect == DEFAULT_ENDPOINT else None
    if found is not None:
        say(f"{found}: the newest store in {BUILD}/; no service answers at {connect}", err)
    return found


def number_of_dwells(text: str) -> int:
    """A number of dwells, or the word for no end. Raises BadParameter."""
    if text == UNLIMITED:
        return NO_END
    if not (text.isascii() and text.isdecimal() and len(text) <= len(str(MAX_DWELLS)) and 1 <= int(text) <= MAX_DWELLS):
        raise typer.BadParameter(f"{text!r}: must be 1 .. {MAX_DWELLS} or {UNLIMITED}")
    return int(text)


ConnectOption = Annotated[
    str, typer.Option(envvar=CONNECT_VARIABLE, callback=endpoints, help="Endpoint of a Zenoh router.")
]
AskedOption = Annotated[
    str, typer.Option(envvar=CONNECT_VARIABLE, callback=one_source, help="Endpoint of a Zenoh router.")
]
SharedServicesOption = Annotated[
    str | None,
    typer.Option(envvar=CONNECT_VARIABLE, callback=endpoints, help="Use the services behind this router; start none."),
]
ZenohConfigOption = Annotated[
    str | None,
    typer.Option(
        "--zenoh-config",
        metavar="FILE",
        envvar=CONFIG_VARIABLE,
        help="Settings of Zenoh's own, JSON5: certificates and whatever else it can do.",
    ),
]
ScenarioArgument = Annotated[
    str, typer.Argument(help="Name of a built-in scenario, or a TOML file.", autocompletion=completion.scenarios)
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Another value in the scenario: radar.array.n_tx=32. May repeat."),
]
RuleOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"Action-selection policy, as --set radar.planner.rule=NAME: {names_of(RULE.built_in)}.",
        autocompletion=completion.rules,
    ),
]
DwellsOption = Annotated[int | None, typer.Option(min=1, max=MAX_DWELLS, help="Instead of the scenario's number.")]
RunDwellsOption = Annotated[
    int | None,
    typer.Option(
        metavar=f"N|{UNLIMITED}",
        parser=number_of_dwells,
        help=f"Instead of the scenario's number; {UNLIMITED}: until the run is ended.",
    ),
]
FRONT_END_VARIABLE = "COGRADAR_FRONT_END"
_FRONT_END = (
    "simulated, recorded:FILE[#RUN], or your own: PATH.py:NAME, package.module:NAME, or zenoh:NAME[@ENDPOINT] for a"
    " process in any language."
)
FrontEndOption = Annotated[str, typer.Option(help=_FRONT_END)]
ServiceFrontEndOption = Annotated[str, typer.Option(envvar=FRONT_END_VARIABLE, help=f"Emulator: {_FRONT_END}")]
RunArgument = Annotated[
    str | None, typer.Argument(metavar="RUN", help="As `query runs` shows it; the newest if left out.")
]
ServiceStoreOption = Annotated[
    str,
    typer.Option(
        envvar="COGRADAR_STORE",
        help=f"Recorder and metrics: SQLite file of the runs, or {SHORT}.",
        autocompletion=completion.stores,
    ),
]
StoreOption = Annotated[
    str | None,
    typer.Option(callback=one_source, help="Read this store; ask no service.", autocompletion=completion.stores),
]
RunFilter = Annotated[str | None, typer.Option("--run", metavar="RUN", help="Only this run.")]
ScenarioFilter = Annotated[
    str | None, typer.Option(help="Only runs of this scenario.", autocompletion=completion.scenarios)
]
SeedFilter = Annotated[int | None, typer.Option(min=0, max=2**63 - 1, help="Only runs of this seed.")]
CsvOption = Annotated[bool, typer.Option("--csv", help="Print CSV only.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON only.")]


LINE_S = 30.0  # between two lines of progress, where there is no terminal
_WORDS: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}  # of a line


class Stop(SignalEvent):
    """Set by SIGINT or SIGTERM; remembers which."""

    exit_code = Interrupted.exit_code
    at_once = False  # raise KeyboardInterrupt wherever the main thread is: for work that leaves nothing behind

    def __init__(self) -> None:
        super().__init__()
        self._before = {number: signal.signal(number, self._on_signal) for number in (signal.SIGINT, signal.SIGTERM)}

    def forget(self) -> None:
        """Let signals do again what they did before."""
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def _on_signal(self, number: int, _frame: Any) -> None:
        self.exit_code = 128 + number
        self.set()
        if self.at_once:
            raise KeyboardInterrupt  # no handler of exceptions takes it for a fault of what it interrupts


@contextmanager
def command(*, at_once: bool = False, zenoh_config: str | None = None) -> Iterator[Stop]:
    """The body of a command. What ends it short of its aim is a line on standard error and an exit code, here only.

    `zenoh_config` is for all sessions of the command, and of the processes that it starts.
    """
    stop = Stop()
    stop.at_once = at_once
    try:
        with _settings_of_zenoh(zenoh_config):
            yield stop
    except (Interrupted, KeyboardInterrupt) as error:
        _end(error if isinstance(error, Interrupted) else Interrupted("interrupted"), stop.exit_code)
    except SystemError:  # what compiled code makes of the interrupt
        if not stop.is_set():
            raise
        _end(Interrupted("interrupted"), stop.exit_code)
    except Failure as error:
        _end(error, error.exit_code)
    except (ScenarioError, PluginError) as error:
        _end(error, BadInput.exit_code)
    except ConnectionError as error:
        _end(error, RunFailed.exit_code)
    finally:
        stop.forget()


@contextmanager
def _settings_of_zenoh(file: str | None) -> Iterator[None]:
    """Put a file where all that opens a session finds it. Raises BadInput for one that Zenoh does not take."""
    if not file:
        yield
        return
    from cogradar.shared.wire.session import BadConfig, check_config

    try:
        check_config(file)
    except BadConfig as error:
        raise BadInput(f"--zenoh-config {error}") from None
    before = os.environ.get(CONFIG_VARIABLE)
    os.environ[CONFIG_VARIABLE] = file
    try:
        yield
    finally:
        if before is None:
            del os.environ[CONFIG_VARIABLE]
        else:
            os.environ[CONFIG_VARIABLE] = before


def call(app: typer.Typer) -> NoReturn:
    """Run a command line. What is wrong with it is a line on standard error, like any other bad input."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal without umlauts
    try:
        code = app(standalone_mode=False)
        if not sys.stdout.closed:  # as it is once its reader is gone
            sys.stdout.flush()
        sys.exit(code)
    except OSError as error:
        if error.errno not in _UNWRITTEN:
            raise
        complain(f"{error.filename or 'standard output'}: {error.strerror}: the output is not complete")
        # Python would try once more to write what is left, and fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(RunFailed.exit_code)
    except typer.TyperException as error:
        if str(error.format_message()):  # else it is the help, which is there already
            complain(wrong_usage(error))
        sys.exit(error.exit_code)


def say(text: str, console: Console = out, style: str = "") -> None:
    """Print prose, broken between words; a line that begins with a blank is whole: a command to be pasted."""
    for line in text.splitlines():
        parts = [line] if line.startswith(" ") else textwrap.wrap(line, console.width, **_WORDS)
        console.print(Text("\n".join(parts), style), soft_wrap=True)


class Lines:
    """What goes on, for a file or a pipe: a line on standard error now and then, if it has changed."""

    def __init__(self, each_s: float = LINE_S) -> None:
        self._said, self._each_s, self._next_s = "", each_s, time.monotonic() + each_s

    def __call__(self, text: str) -> None:
        """Note how far it is."""
        if text != self._said and time.monotonic() >= self._next_s:
            err.print(text, soft_wrap=True)
            self._said, self._next_s = text, time.monotonic() + self._each_s


@contextmanager
def progress(console: Console, each_s: float = LINE_S) -> Iterator[Callable[[str], None]]:
    """Show what goes on: at one place of a terminal, elsewhere by lines, one in so many seconds."""
    if console.is_terminal:
        with console.status("") as status:
            yield lambda text: status.update(printable_lines(text))
    else:
        yield Lines(each_s)


def complain(text: str) -> None:
    """Say what is wrong, on standard error: in a pipe a line for a line."""
    whole = "\n".join(printable(line) for line in unsaid(text).splitlines())
    if err.is_terminal:
        say(whole, err, "red")
    else:
        err.print(whole, soft_wrap=True)


def wrong_usage(error: typer.TyperException) -> str:
    """What is wrong with a command line: the option, its value, what is allowed, and where that is said."""
    context = getattr(error, "ctx", None)
    where = f" (see {context.command_path} --help)" if context is not None else ""
    if not isinstance(error, typer.BadParameter) or not error.message:
        pieces = [] if context is None else context.command.collect_usage_pieces(context)
        words = [
            piece.replace("{", "").replace("}", "").replace("......", "...")
            for piece in pieces
            if not piece.startswith("[")  # options: of several arguments any may be the missing one
        ]
        if (
            context is not None and isinstance(error, typer.BadParameter) and len(words) > 1
        ):  # any may be the missing one
            where = f": {' '.join([context.command_path, *words])}{where}"
        return " ".join(error.format_message().split()).removesuffix(".") + where
    name = error.param_hint
    if error.param is not None:
        name = error.param.opts[0] if error.param.opts[0].startswith("-") else error.param.opts[0].upper()
    if not isinstance(error.__cause__, ValidationError):
        return f"{name}: {error.message}{where}" if name else f"{error.message}{where}"
    (first, *_) = error.__cause__.errors()
    adapter = getattr(error.param.get_runtime_param(), "adapter", None) if error.param is not None else None
    schema = adapter.json_schema() if adapter is not None else {}
    _, is_choice, choices = first["msg"].replace("'", "").removesuffix(".").partition(" is not one of ")
    must = f"must be one of {choices}" if is_choice else allowed(schema) if "type" in schema else first["msg"]
    return f"{name} = {first['input']}: {must}{where}"


def _end(error: Exception, code: int) -> None:
    complain(str(error))
    raise typer.Exit(code) from None


def filters(**given: object) -> dict[str, str]:
    """Options as the parameters of a query: those that were given."""
    return {name: str(value) for name, value in given.items() if value is not None}


def print_json(document: Any) -> None:
    """The one line that `--json` prints."""
    sys.stdout.write(json.dumps(document) + "\n")


def print_csv(rows: Sequence[dict[str, Any]]) -> None:
    """What `--csv` prints: a line of the keys that `--json` has, then a line per row; nothing without rows."""
    if rows:
        writer = csv.DictWriter(sys.stdout, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _shown(value) for key, value in row.items()} for row in rows)


class Pace(StrEnum):
    """When the next dwell begins."""

    LOCKSTEP = "lockstep"  # as soon as its waveform is there; nothing is lost, and equal seeds give equal runs
    REALTIME = "realtime"  # when its time has come, whatever is missing


RateOption = Annotated[
    float | None,
    typer.Option(min=0.001, max=MAX_RATE_HZ, metavar="HZ", help="Dwells per second in real time; 1/dt_s if left out."),
]


def rate_of(scenario: Scenario, pace: Pace, rate: float | None) -> float:
    """Dwells a second, 0 in lockstep. Raises BadInput for a rate without real time."""
    if pace is Pace.REALTIME:
        return rate or 1.0 / scenario.radar.motion.dt_s
    if rate is not None:
        raise BadInput(f"--rate {rate:g}: applies to --pace realtime only")
    return 0.0
