"""What the terminal shows: progress of a run, its table, answers to queries."""

from collections.abc import Iterable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table
from rich.text import Text

from services.runs.run import WINDOW, Result
from services.runs.run import Progress as RunProgress

if TYPE_CHECKING:
    from services.campaigns.campaign import Tally

# Heading, format of a row of `summary` in metres. Narrow enough for 80 characters.
COLUMNS = (
    ("P_D", "{p_d:.3f}"),
    ("95 % interval", "{p_d_low:.3f} {p_d_high:.3f}"),
    ("bin hits", "{hit_rate:.3f}"),
    ("RMSE km", "{position_rmse_km:.3f}"),
    ("m/s", "{velocity_rmse_m_s:.1f}"),
    ("SNR dB", "{snr_db:.1f}"),
    ("power", "{share:.3f}"),
)


class _Unknown:
    """A value that nobody knows, such as an error without truth."""

    def __format__(self, _: str) -> str:
        return "-"


def in_metres(row: dict[str, Any]) -> dict[str, Any]:
    """The row with its velocities in m/s as well: what people are shown; programs get km/s, as the keys say."""
    velocities = {key: value for key, value in row.items() if "km_s" in key}
    return row | {key.replace("km_s", "m_s"): value and 1e3 * value for key, value in velocities.items()}


class _Live:
    """A live line, as a context; lines can be said above it."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def say(self, text: str) -> None:
        """Print a line above the progress."""
        self._progress.console.print(Text(text), soft_wrap=True)


class RunDisplay(_Live):
    """Live line of a run: dwells, rate, and per target P_D and RMSE so far; 100 characters hold three targets."""

    def __init__(self, console: Console, dwells: int) -> None:
        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}", markup=False),
            TextColumn("{task.fields[note]}", markup=False, table_column=Column(no_wrap=True)),
        )
        super().__init__(Progress(*columns, console=console))
        self._task = self._progress.add_task("starting", total=dwells, rate="", note="")

    def report(self, now: RunProgress) -> None:
        """Show how far the run has come."""
        scans = f"acquiring, {0 if now.k is None else now.k + 1} scans"
        speed = self._progress.tasks[0].speed
        self._progress.update(
            self._task,
            description="P_D, RMSE" if now.targets else scans,
            completed=now.t,
            rate=f"{speed:.1f}/s" if speed and now.targets else "",
            note="  ".join(map(_live, now.targets)) or now.waiting_for,
        )


class CampaignDisplay(_Live):
    """Live line of a campaign: runs done, time taken, time left."""

    def __init__(self, console: Console) -> None:
        columns = (
            SpinnerColumn(),
            TextColumn("runs"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        # A run takes seconds, a strategy's more than another's: the rate is that of the last quarter of an hour.
        super().__init__(Progress(*columns, console=console, speed_estimate_period=900.0))
        self._task = self._progress.add_task("runs", total=None)

    def report(self, now: "Tally") -> None:
        """Show how far the campaign has come."""
        if not now.played:  # what an earlier call played says nothing about the rate
            self._progress.reset(self._task, total=now.total, completed=now.done)
        self._progress.update(self._task, completed=now.done)


def campaign_caption(tally: "Tally", digest: str) -> str:
    """What a campaign took, and the digest of its results."""
    minutes, seconds = divmod(round(tally.wall_s), 60)
    lines = [f"{tally.done} of {tally.total} runs, {tally.played} of them now, in {minutes}:{seconds:02d}"]
    lines += [
        f"  {strategy}: {len(cpu)} runs, {sum(cpu) / len(cpu):.2f} s of CPU each"
        for strategy, cpu in tally.cpu_s.items()
    ]
    return "\n".join([*lines, f"digest {digest}"])


def run_table(result: Result) -> list[Table]:
    """One table per target: a row per window of dwells, if the run is longer than one, and one overall."""
    run = result.run
    tables = []
    for i, overall in enumerate(result.targets):
        lost = "  LOST" if overall["lost"] else ""
        table = Table(
            box=SIMPLE_HEAD,
            pad_edge=False,
            title=f"target {overall['target']}, acquired in {run['acquisition_scans']} scans{lost}",
            title_justify="left",
            title_style="bold",
        )
        table.add_column("dwells", justify="right")
        for heading, _ in COLUMNS:
            table.add_column(heading, justify="right")
        for window in result.windows:
            table.add_row(f"{window[i]['first_dwell']}-{window[i]['last_dwell']}", *_cells(window[i]))
        if result.windows:
            table.add_section()
        table.add_row(f"all {run['dwells']}", *_cells(overall), style="bold")
        tables.append(table)
    return tables


def run_caption(result: Result) -> str:
    """One line that identifies a run and its outcome."""
    run = result.run
    rate = run["dwells"] / result.elapsed_s
    windows = f", windows of {WINDOW} dwells" if result.windows else ""
    return (
        f"{run['run']}: {run['strategy']}, seed {run['seed']}, "
        f"{run['dwells']} dwells in {result.elapsed_s:.1f} s ({rate:.1f}/s){windows}\n"
        "intervals of P_D: Wilson, dwells of this one run as if independent; `cogradar campaign` gives them over runs\n"
        f"{_real_time(result)}{_conflicts(result)}digest {run['digest']}"
    )


def _real_time(result: Result) -> str:
    """What did not come in time; nothing in lockstep, where everything is waited for."""
    if not result.run["rate_hz"]:
        return ""
    late = ", ".join(f"T{row['target']} {100 * row['late']:.2f} %" for row in result.targets)
    stale = 100 * (result.targets[0]["stale"] or 0.0)
    scored = f"{result.targets[0]['n']} of {result.run['dwells']} dwells scored; "
    return f"real time at {result.run['rate_hz']:g} Hz: {scored}late plans {late}; stale waveforms {stale:.2f} %\n"


def _conflicts(result: Result) -> str:
    """Processes that should have said the same and did not: different processors or versions of the program."""
    n = result.run["conflicts"]
    return f"WARNING: {n} messages differed from those that other processes said of the same dwell\n" if n else ""


def rows_table(rows: Iterable[dict[str, Any]]) -> Table:
    """Any answer of metrics as a table."""
    rows = list(rows)
    table = Table()
    for key in rows[0] if rows else ("no rows",):
        table.add_column(Text(key), justify="right")
    for row in rows:  # Text: brackets in a reason or a name are no markup
        table.add_row(*(Text(f"{value:.4g}" if isinstance(value, float) else str(value)) for value in row.values()))
    return table


def _live(row: dict[str, Any]) -> str:
    """`T2 0.94 12.3km 15m/s`: P_D, position and velocity RMSE of a target."""
    form = "T{target} {p_d:.2f} {position_rmse_km:.1f}km {velocity_rmse_m_s:.0f}m/s"
    return form.format(**_shown(row))


def _cells(row: dict[str, Any]) -> Iterable[str]:
    return (form.format(**_shown(row)) for _, form in COLUMNS)


def _shown(row: dict[str, Any]) -> dict[str, Any]:
    return {key: _Unknown() if value is None else value for key, value in in_metres(row).items()}
