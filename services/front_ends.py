"""Which front end an emulator drives: the simulated one, a recording, or a real receiver of somebody: a class, or a
process in any language.

`simulated`, `recorded:FILE[#RUN]`, `zenoh:NAME[@ENDPOINT]`, `PATH.py:NAME` or `package.module:NAME`;
docs/howto/front-end.md.
"""

import re
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any

from cogradar.services.certs.endpoints import fault_of
from cogradar.services.emulator.aside import Check, OpensAside
from cogradar.services.emulator.foreign import OpensForeign
from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, OpenFrontEnd, Settings
from cogradar.services.emulator.own_thread import OpensInOwnThread
from cogradar.services.emulator.recorded import RecordedFrontEnd, check_fits
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.recorder.journal import Journal, Unreadable
from cogradar.services.recorder.store.address import RECORDED, is_server, recording, shown
from cogradar.shared.protocol.messages import EmulatorCheckpoint
from cogradar.shared.protocol.topics import FRONT_END_NAME
from cogradar.shared.scenario.plugins.kinds import FRONT_END
from cogradar.shared.scenario.plugins.names import OWN, PluginError, PluginRefused, without_name
from cogradar.shared.scenario.plugins.resolver import Caller, resolve
from cogradar.shared.scenario.plugins.sources import settled as settled_name
from cogradar.shared.scenario.radar_config import RadarConfig

SIMULATED = "simulated"
ZENOH = "zenoh:"


def open_front_end(name: str, connect: str = "", check: Callable[[], None] = lambda: None) -> OpenFrontEnd:
    """What opens the front end of this name for a run. Raises BadInput if there is none.

    connect : endpoints of the system's router, comma-separated; empty: there is none that others know, nor another run
    check   : raises Interrupted when the process is to end, while a front end in another process is waited for
    """
    if name == SIMULATED:
        return SimulatedFrontEnd.open
    if name.startswith(RECORDED):
        return _recorded(name)
    if name.startswith(ZENOH):
        return _over_zenoh(name, connect, check)
    return OpensInOwnThread(*_named(name))


def cure_of_silence(name: str) -> str:
    """What to do about a front end that opens or answers so late that it is waited for, as the end of a sentence."""
    if name.startswith(ZENOH):
        return ": is its process up, and at the same router?"
    if name.startswith(RECORDED) or name == SIMULATED:
        return ""
    return f": `cogradar check {name}` opens and asks it without a run"


def settled(name: str) -> str:
    """The same front end, named so that it stays the same: of a recording with the run, and with the whole path."""
    if not name.startswith(RECORDED):
        open_front_end(name)
        return name
    file, run = _recording(name)
    return f"{RECORDED}{file if is_server(file) else Path(file).resolve()}#{run}"


def _over_zenoh(name: str, connect: str, check: Callable[[], None]) -> OpenFrontEnd:
    called, _, where = name.removeprefix(ZENOH).partition("@")
    if not re.fullmatch(FRONT_END_NAME, called):
        raise BadInput(
            f"{name}: must be {ZENOH}NAME or {ZENOH}NAME@ENDPOINT; a name has 1 to 48 letters, digits, '.', '_' and"
            " '-', the first a letter or digit"
        )
    if not (endpoints := where or connect):
        raise BadInput(
            f"{name}: no front end can know the router of this run: say where it listens, as in"
            f" {ZENOH}{called}@tcp/127.0.0.1:7448, or where a router of yours does"
        )

    if fault := fault_of(endpoints):
        raise BadInput(f"{name}: {fault}")

    def opens(check: Check) -> OpenFrontEnd:
        return OpensForeign(called, endpoints.split(","), check)

    return OpensAside(opens, check) if connect else opens(check)


def _recorded(name: str) -> OpenFrontEnd:
    file, run = _recording(name)

    def open_recording(checkpoint: EmulatorCheckpoint) -> FrontEnd:
        with ExitStack() as opened:
            try:
                journal = opened.enter_context(closing(Journal(file, read_only=True)))
                start = journal.start(run)
            except (BadInput, StoreFailed, Unreadable) as error:
                raise FrontEndError(f"{shown(file)}: {error}") from None
            if start is None:
                raise FrontEndError(f"{shown(file)}: no run {run}")
            radars = (RadarConfig.model_validate(radar) for radar in (start.scenario["radar"], checkpoint.radar))
            check_fits(*radars)
            return RecordedFrontEnd(partial(_scan, journal, run), opened.pop_all().close)

    return open_recording


def _scan(journal: Journal, run: str, k: int) -> bytes | None:
    try:
        return journal.message(run, k, "scan", 0)
    except StoreFailed as error:
        raise FrontEndError(str(error)) from None


def _recording(name: str) -> tuple[str, str]:
    """File and run of a recording; the newest complete run if none is named."""
    file, run = recording(name)
    try:
        with closing(Journal(file, read_only=True)) as journal:
            rows = journal.read(
                "SELECT run.run, COUNT(message.k) AS n, MAX(message.k) AS last FROM run LEFT JOIN message"
                " ON message.run = run.run AND topic = 'scan' WHERE run.run = ? OR (? = '' AND status = 'complete')"
                " GROUP BY run.run ORDER BY run.place DESC LIMIT 1",
                [run, run],
            )
    except StoreFailed as error:
        raise BadInput(str(error)) from None
    if not rows:
        raise BadInput(f"{shown(file)}: no run {run}" if run else f"{shown(file)}: no complete run")
    (found,) = rows
    if found["n"] == 0:
        raise BadInput(f"{shown(file)}: no scans of {found['run']} are stored")
    if found["n"] != found["last"] + 1:
        raise BadInput(f"{shown(file)}: scans of {found['run']} are missing, only a run without gaps can be replayed")
    return file, str(found["run"])


def _named(name: str) -> tuple[Callable[[Settings], FrontEnd], str]:
    """The class, or function, of somebody else, and its name with the hash of its source."""
    try:
        source = settled_name(FRONT_END, name, Path())
        made: Callable[[Settings], FrontEnd] = resolve(FRONT_END, source)
    except PluginError as error:
        is_none = not all(name.rpartition(":"))  # no source, or no name in it
        must = f"must be {SIMULATED}, {RECORDED}FILE[#RUN], {ZENOH}NAME[@ENDPOINT], or your own: {OWN}"
        if is_none and name.endswith(".py"):
            must = f"say which class or function of it makes front ends: {name}:NAME"
        raise BadInput(f"{name}: {must if is_none else without_name(error, name)}") from None
    return made, source


def guarded(make: Any, call: Caller) -> Callable[[Settings], FrontEnd]:
    """A class, or a function, that makes front ends; the caller handles what these raise."""
    if not callable(make):
        raise PluginRefused(f"{call.short}: must be a class or a function (settings) -> FrontEnd")
    lacking = [method for method in ("transmit", "close") if isinstance(make, type) and not hasattr(make, method)]
    if lacking:
        raise PluginRefused(f"{call.short}: a front end needs the method {lacking[0]}, which it has not")
    made: Callable[[Settings], FrontEnd] = make
    return made
