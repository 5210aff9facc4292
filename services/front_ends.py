"""Which front end an emulator drives: the simulated one, a recording, or a class of somebody with a real receiver.

`simulated`, `recorded:FILE[#RUN]`, `PATH.py:NAME` or `package.module:NAME`; docs/howto/front-end.md.
"""

import importlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, OpenFrontEnd, Settings
from cogradar.services.emulator.own_thread import OpensInOwnThread
from cogradar.services.emulator.recorded import RecordedFrontEnd, check_fits
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.recorder.journal import Journal, Unreadable
from cogradar.shared.protocol.messages import EmulatorCheckpoint
from cogradar.shared.scenario.radar_config import RadarConfig

SIMULATED = "simulated"
_RECORDED = "recorded:"


def open_front_end(name: str) -> OpenFrontEnd:
    """What opens the front end of this name for a run. Raises BadInput if there is none."""
    if name == SIMULATED:
        return SimulatedFrontEnd.open
    if name.startswith(_RECORDED):
        return _recorded(name)
    return OpensInOwnThread(_named(name))


def settled(name: str) -> str:
    """The same front end, named so that it stays the same: of a recording with the run, and with the whole path."""
    if not name.startswith(_RECORDED):
        open_front_end(name)
        return name
    file, run = _recording(name)
    return f"{_RECORDED}{Path(file).resolve()}#{run}"


def _recorded(name: str) -> OpenFrontEnd:
    file, run = _recording(name)

    def open_recording(checkpoint: EmulatorCheckpoint) -> FrontEnd:
        try:
            journal = Journal(file, read_only=True)
            start = journal.start(run)
        except (BadInput, StoreFailed, Unreadable) as error:
            raise FrontEndError(f"{file}: {error}") from None
        if start is None:
            raise FrontEndError(f"{file}: no run {run}")
        check_fits(RadarConfig.model_validate(start.scenario["radar"]), RadarConfig.model_validate(checkpoint.radar))
        return RecordedFrontEnd(lambda k: journal.message(run, k, "scan", 0), journal.close)

    return open_recording


def _recording(name: str) -> tuple[str, str]:
    """File and run of a recording; the newest complete run if none is named."""
    file, _, run = name.removeprefix(_RECORDED).partition("#")
    try:
        journal = Journal(file, read_only=True)
        rows = journal.read(
            "SELECT run.run, COUNT(message.k) AS n, MAX(message.k) AS last FROM run LEFT JOIN message"
            " ON message.run = run.run AND topic = 'scan' WHERE run.run = ? OR (? = '' AND status = 'complete')"
            " GROUP BY run.run ORDER BY run.rowid DESC LIMIT 1",
            [run, run],
        )
        journal.close()
    except StoreFailed as error:
        raise BadInput(str(error)) from None
    if not rows:
        raise BadInput(f"{file}: no run {run}" if run else f"{file}: no complete run")
    (found,) = rows
    if found["n"] == 0:
        raise BadInput(f"{file}: no scans of {found['run']} are stored")
    if found["n"] != found["last"] + 1:
        raise BadInput(f"{file}: scans of {found['run']} are missing, only a run without gaps can be played")
    return file, str(found["run"])


def _named(name: str) -> Callable[[Settings], FrontEnd]:
    """The class, or function, of somebody else."""
    module_name, colon, attribute = name.rpartition(":")
    if not colon or not module_name or not attribute.isidentifier():
        raise BadInput(f"{name}: must be {SIMULATED}, {_RECORDED}FILE[#RUN], PATH.py:NAME or package.module:NAME")
    try:
        is_file = module_name.endswith(".py")
        module = _module_of_file(Path(module_name)) if is_file else importlib.import_module(module_name)
    except Exception as error:  # noqa: BLE001 - somebody else's file may raise anything
        raise BadInput(f"{name}: cannot be imported: {type(error).__name__}: {error}") from None
    make = getattr(module, attribute, None)
    if not callable(make):
        raise BadInput(f"{name}: there is no {attribute} that can be called in {module_name}")
    lacking = [method for method in ("transmit", "close") if isinstance(make, type) and not hasattr(make, method)]
    if lacking:
        raise BadInput(f"{name}: a front end needs the method {lacking[0]}, which {attribute} has not")
    made: Callable[[Settings], FrontEnd] = make
    return made


def _module_of_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise FileNotFoundError("no such file")
    name = f"front_end_{path.stem}"  # must not hide a module of that name
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError("not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # as for any module: dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module
