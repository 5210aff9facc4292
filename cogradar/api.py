"""What `import cogradar` offers. Lengths are in km, velocities in km/s, times in dwells; in questions targets count
from 1, as in the paper.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self, TypedDict, Unpack

from cogradar.running import Player, load, play, run
from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.arrays.records import Records
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.errors import BadInput, Failure, NoMetrics, RunFailed
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario

__all__ = [
    "BadInput",
    "CogradarError",
    "Dwell",
    "NoMetrics",
    "Player",
    "Records",
    "Result",
    "RunFailed",
    "Runs",
    "Scenario",
    "Strategy",
    "connect",
    "load",
    "open",
    "play",
    "run",
]

CogradarError = Failure

Rows = list[dict[str, Any]]


class Which(TypedDict, total=False):
    """Which rows are asked for."""

    run: str  # name of one run, or "all": each, of equal ones one; if left out the newest that the others allow
    scenario: str
    strategy: str
    seed: int
    target: int  # counted from 1
    dwells: tuple[int, int] | str  # the first and the last; or "1:20", as on the command line
    limit: int  # rows at most,
    offset: int  # ... after so many that are left out


class Runs:
    """Runs of a store or of a metrics service, and what can be asked about them; rows as `cogradar query --json` has.

    A question that makes no sense raises BadInput, a missing service NoMetrics. A store is closed by `close`, or at the
    end of a `with`.
    """

    def __init__(
        self, ask: Callable[[str, dict[str, str]], Rows], close: Callable[[], None] = lambda: None, source: str = ""
    ) -> None:
        self._ask, self.close, self._source = ask, close, source
        self._endpoint = ""  # of services that can be commanded

    def __repr__(self) -> str:
        of = f" of {self._source}" if self._source else ""
        return f"<Runs{of}: ask .runs(), .result(), .summary(), .picture(), .p_d(), .rmse() or .tracks()>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def result(self, run: str | None = None) -> Result:
        """One run as arrays, the newest if no name is given; of one that goes on, what it has come to by now."""
        from cogradar.services.analysis.stored_run import StoredRun

        return Result(StoredRun(self._ask, run))

    def runs(self, **which: Unpack[Which]) -> Rows:
        """A row per run: what was asked for, how far it has come, how it ended; takes neither target nor dwells."""
        return self._asked("runs", which)

    def tracks(self, **which: Unpack[Which]) -> Rows:
        """A row per dwell and target: true state x, vx, y, vy; estimate x_hat ...; bins, SNR, share of the power."""
        return self._asked("tracks", which)

    def p_d(self, **which: Unpack[Which]) -> Rows:
        """A row per scenario, strategy and target: detection probability with Wilson's 95 % interval."""
        return self._asked("p_d", which)

    def rmse(self, **which: Unpack[Which]) -> Rows:
        """A row per scenario, strategy and target: root mean squared errors of position (km) and velocity (km/s)."""
        return self._asked("rmse", which)

    def consistency(self, **which: Unpack[Which]) -> Rows:
        """A row per scenario, strategy and acceleration of the targets: mean NEES, and its share beyond 99 %."""
        return self._asked("consistency", which)

    def confirmation(self, **which: Unpack[Which]) -> Rows:
        """A row per scenario and strategy with an unknown number of targets: time from visible to confirmed."""
        return self._asked("confirmation", which)

    def summary(self, **which: Unpack[Which]) -> Rows:
        """A row per run and target: P_D, errors, bin hits, mean SNR and power, what came late, whether it was lost."""
        return self._asked("summary", which)

    def picture(self, **which: Unpack[Which]) -> Rows:
        """A row per run, of all targets together: GOSPA, completeness, swaps; takes neither target nor dwells."""
        return self._asked("picture", which)

    def antennas(self, **which: Unpack[Which]) -> Rows:
        """A row per run and transmit antenna: its power and its peak over the mean; takes no target."""
        return self._asked("antennas", which)

    def commands(self, **which: Unpack[Which]) -> Rows:
        """A row per command of a run: who asked for what, when, from which dwell on, and what became of it."""
        return self._asked("commands", which)

    def command(self, run: str, action: str, at: int = 0) -> dict[str, Any]:
        """Command a run that goes on, in words as `cogradar command` takes them: "power 0.5"; its row of `commands`.

        at : not before this dwell, counted from 0

        BadInput if it is refused, RunFailed if no answer comes.
        """
        from cogradar.services.runs.command import command_on

        if not self._endpoint:
            raise BadInput("a store cannot be commanded: use cogradar.connect")
        return command_on(self._endpoint, run, action.split(), at)

    def _asked(self, metric: str, which: Which) -> Rows:
        parameters = {key: str(value) for key, value in which.items()}
        match which.get("dwells", ""):
            case str():
                pass
            case [first, last]:
                parameters["dwells"] = f"{first}:{last}"
            case other:
                raise BadInput(f"dwells = {other!r}: must be (first, last) or 'first:last', either may be empty")
        return self._ask(metric, parameters)


def connect(endpoint: str = "tcp/127.0.0.1:7447") -> Runs:
    """Runs of the metrics service behind the Zenoh router at an endpoint; one session per question.

    Raises BadInput for what is no endpoint; whether somebody answers there is seen with the first question.
    """
    from cogradar.services.certs.endpoints import fault_of
    from cogradar.services.metrics.client import ask_service

    if fault := fault_of(str(endpoint)):
        raise BadInput(f"endpoint: {fault}")
    runs = Runs(partial(ask_service, endpoint), source=endpoint)
    runs._endpoint = endpoint
    return runs


def open(file: str | Path) -> Runs:  # noqa: A001 - read as cogradar.open, as gzip.open is
    """Runs of a store file, as `cogradar run --store` and `campaign` write it. Raises BadInput if it is none."""
    from cogradar.services.metrics.answers import answer
    from cogradar.services.metrics.store import Store
    from cogradar.services.recorder.journal import Journal

    store = Store(Journal(str(file), read_only=True))
    return Runs(partial(answer, store), store.close, store.journal.path)
