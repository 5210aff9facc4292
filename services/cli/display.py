"""What the terminal shows: progress of a run, its tables, answers to queries."""

import time
from collections.abc import Sequence
from shlex import quote
from textwrap import shorten
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

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
from rich.table import Column as ProgressCell

from cogradar.services.analysis.report_tables import conflict_warning
from cogradar.services.analysis.tables import Column, Table, in_metres
from cogradar.services.cli.console import Lines, say
from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.metrics.answers import Rows
from cogradar.services.runs.run import Progress as RunProgress
from cogradar.services.runs.run import Result, window
from cogradar.shared.protocol.orders import PAUSED
from cogradar.shared.scenario.limits import NO_END, said_dwells

if TYPE_CHECKING:
    from cogradar.services.campaigns.campaign import Tally as CampaignTally
    from cogradar.services.skies.readers.report import Tally
    from cogradar.shared.scoring.prospects import Prospect

COLUMNS = (
    Column("dwells", "{span}"),
    Column("P_D", "{p_d:.3f}"),
    Column("95 % interval", "{p_d_low:.3f} {p_d_high:.3f}"),
    Column("in bin", "{in_bin:.3f}"),
    Column("RMSE km", "{position_rmse_km:.3f}"),
    Column("m/s", "{velocity_rmse_m_s:.1f}"),
    Column("SNR dB", "{snr_db:.1f}"),
    Column("power", "{share:.3f}"),
)


NO_ROWS = {  # Why there may be none, of runs that are there.
    "confirmation": 'it is about an unknown number of targets, radar.tracks = "unknown", which no run asked about has;'
    " `cogradar query summary` says what became of each target of other runs",
    "tracks": "rows are of targets: of an unknown number without truth `cogradar export RUN --out tracks.csv` has the"
    " tracks",
    "summary": "rows are of targets: of an unknown number without truth `cogradar query picture` has all tracks"
    " together",
    "commands": "no command was given to this run: `cogradar command --help` says which there are",
}
NO_DIGEST = "none: not all of the run is there"
SCORED = Column("scored", "{n}")  # dwells of them in which the target was there, and which came
PICTURED = Column(
    "",
    "all together: GOSPA {gospa_km:.2f} km, completeness {completeness:.3f}, spuriousness {spuriousness:.3f},"
    " swaps {swaps}, tracks {tracks}, false tracks per hour {false_tracks_per_hour:.3g}",
)
BLIND = Column(
    "",
    "blind cells: {blind_cells} in {blind_dwells} dwells, {blind_percent:.3g} % of those tested; their noise had no"
    ' estimate, so that they detect nothing: radar.receiver.noise = "rows" always has one',
)
UNMEASURED = Column(
    "",
    "not measured: {unmeasured_looks} looks, {unmeasured_dwells} dwells as a whole; they count neither for nor against"
    " a track, and not in P_D",
)
LIVE = Column("", "T{target} {p_d:.2f} {position_rmse_km:.1f}km {velocity_rmse_m_s:.0f}m/s")
LIVE_HEAD = 35  # characters of the live line before its targets, without the count of dwells
BAR = 10
MORE = " ..."  # in place of words that have no room
FAULT_AGAIN_S = 10.0  # from a line about a front end to the next, which says something else
SLOW, SLOW_AFTER_S = 0.8, 5.0  # of the rate in real time, and seconds, from which on it is worth a line
STALE_SHARE, STALE_AFTER = 0.2, 20  # of waveforms in real time, and dwells, from which on it is worth a line


class _Live:
    """A live line, as a context; lines can be sent above it. Without a terminal it is a line now and then."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        progress.disable = not progress.console.is_terminal
        self._lines = Lines() if progress.disable else None

    def _tell(self, text: str) -> None:
        """How far it is, where there is no terminal."""
        if self._lines is not None:
            self._lines(text)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Show nothing more."""
        self._progress.stop()

    def notify(self, text: str) -> None:
        """Print a line above the progress."""
        say(text, self._progress.console)


class RunDisplay(_Live):
    """Live line of a run: dwells, rate, and P_D and RMSE so far of as many targets as fit, the worst ones first."""

    def __init__(self, console: Console, dwells: int) -> None:
        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False, table_column=ProgressCell(no_wrap=True)),
            BarColumn(BAR, table_column=ProgressCell(no_wrap=True, min_width=BAR)),
            TextColumn("{task.completed}{task.fields[of]}", table_column=ProgressCell(no_wrap=True)),
            TextColumn("{task.fields[rate]}", markup=False, table_column=ProgressCell(no_wrap=True)),
            TextColumn("{task.fields[note]}", markup=False, table_column=ProgressCell(no_wrap=True)),
        )
        super().__init__(Progress(*columns, console=console))
        self._task = self._progress.add_task(
            "starting",
            total=None if dwells == NO_END else dwells,
            of="" if dwells == NO_END else f"/{dwells}",
            rate="",
            note="",
        )
        self._room = console.width - LIVE_HEAD - 2 * len(str(dwells))
        self._says_stale = False
        self._fault, self._fault_s = "", float("-inf")  # told last, and when

    def report(self, now: RunProgress) -> None:
        """Show how far the run has come."""
        head = "P_D, RMSE" if now.targets else f"acquiring, {0 if now.k is None else now.k + 1} scans"
        if now.confirmed is not None:
            head = f"{now.confirmed} tracks"
        self._tell(f"dwell {now.t} of {said_dwells(now.dwells)}" if now.t else head)
        speed = self._progress.tasks[0].speed
        stale = (now.targets[0].get("stale") or 0.0) if now.targets else 0.0
        if stale > STALE_SHARE and now.t >= STALE_AFTER and not self._says_stale:
            self._says_stale = True
            self.notify(
                f"{100 * stale:.0f} % of the waveforms came too late so far: a lower --rate gives them more time"
            )
        is_soon = time.monotonic() - self._fault_s <= FAULT_AGAIN_S and self._fault != PAUSED
        if now.fault not in {"", self._fault} and not is_soon:
            self._fault, self._fault_s = now.fault, time.monotonic()
            self.notify(f"not measured: {now.fault}")
        self._progress.update(
            self._task,
            description=head,
            completed=now.t,
            rate=f"{speed:.1f}/s" if speed and now.targets else "",
            note=_fitting([row for row in now.targets if row["n"]], self._room)
            or shorten(now.waiting_for, max(len(MORE), self._room + 9 - len(head)), placeholder=MORE),
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

    def report(self, now: "CampaignTally") -> None:
        """Show how far the campaign has come."""
        if not now.played:  # what an earlier call played says nothing about the rate
            self._progress.reset(self._task, total=now.total, completed=now.done)
        self._progress.update(self._task, completed=now.done)
        self._tell(f"{now.done} of {now.total} runs")


def campaign_caption(tally: "CampaignTally", conflicts: int, digest: str) -> str:
    """What a campaign took, and the digest of its results."""
    minutes, seconds = divmod(round(tally.wall_s), 60)
    lines = [f"{tally.done} of {tally.total} runs, {tally.played} of them now, in {minutes}:{seconds:02d}"]
    lines += [
        f"  {strategy}: {len(cpu)} runs, {sum(cpu) / len(cpu):.2f} s of CPU each"
        for strategy, cpu in tally.cpu_s.items()
    ]
    return "\n".join([*lines, *conflict_warning(conflicts), f"digest {digest}"])


def check_table(found: Sequence["Prospect"]) -> Table:
    """What `check` says of the targets."""
    columns = [
        Column("target", "{target}"),
        Column("range km", "{range_km:.1f}"),
        Column("angle deg", "{angle_deg:.1f}"),
        Column("SNR dB", "{snr_db:.1f}"),
        Column("array dB", "{array_snr_db:.1f}"),
        Column("disturbance dB", "{disturbance_db:+.1f}"),
        *(Column(f"P_D {name}", f"{{{name}:.3f}}") for name in found[0].p_d),
        *([Column("seen after s", "{seconds:.3g}")] if found[0].seconds is not None else []),
    ]
    return Table("", columns, [{**prospect._asdict(), **prospect.p_d} for prospect in found])


def recording_table(tally: "Tally") -> Table:
    """What became of the rows of a recording."""
    columns = [
        Column("", "{why}", left=True),
        Column("rows", "{rows}"),
        Column("first", "{first}"),
        Column("last", "{last}"),
    ]
    ends = [
        {"why": why, "rows": n, "first": None, "last": None} for why, n in (("read", tally.rows), ("kept", tally.kept))
    ]
    rows = [ends[0], *tally.lines, ends[1]]
    return Table(tally.form, columns, rows, bold=frozenset({len(rows) - 1}))


def run_tables(result: Result) -> list[Table]:
    """One table per target: a row per window of dwells, if the run is longer than one, and one overall."""
    tables = []
    for i, overall in enumerate(result.targets):
        if not overall["n"]:  # it never was there, or never followed
            continue
        lost = "  LOST" if overall["lost"] else ""
        lost += "" if overall["tracked"] else ", not tracked"
        has_track = overall["tracked"] or overall["false_track"]
        scans = result.run["acquisition_scans"]
        acquired = f", acquired in {scans} scan{'s' * (scans != 1)}" if has_track else ""
        if result.is_unknown:
            acquired = f", followed from dwell {overall['confirmed_t']}"
        title = f"target {overall['target']}{acquired}{_outages(overall)}{lost}"
        rows = [
            *(
                {**in_metres(row[i]), "span": "{first_dwell}-{last_dwell}".format(**row[i])}
                for row in result.windows
                if row[i]["n"]
            ),
            {**in_metres(overall), "span": f"all {result.run['t']}"},
        ]
        columns = list(COLUMNS if overall["p_d"] is not None else (COLUMNS[0], COLUMNS[-1]))  # without truth
        if any(row["n"] < row["last_dwell"] - row["first_dwell"] + 1 for row in rows):
            columns.insert(1, SCORED)
        tables.append(Table(title, columns, rows, bold=frozenset({len(rows) - 1})))
    return tables


def _outages(row: dict[str, Any]) -> str:
    """How long its track was out of a target's bin; nothing if it never was, or if that is unknown."""
    if not row["outage"]:
        return ""
    dwells, longest = row["outage"], row["outage_longest"]
    return (
        f", out of its bin for {dwells} dwells, at most {longest} in a row"
        if dwells > 1
        else ", out of its bin for a dwell"
    )


def run_caption(result: Result) -> str:
    """One line that identifies a run and its outcome."""
    run = result.run
    rate = run["t"] / result.elapsed_s  # not "dwells": a run without an end has none, one that was ended has more
    windows = f", windows of {window(run['dwells'])} dwells" if result.windows else ""
    lines = [
        f"{run['run']}: {run['strategy']}, seed {run['seed']}, "
        f"{run['t']} dwells in {result.elapsed_s:.1f} s ({rate:.1f}/s){windows}",
    ]
    if run["dwells"] is not None and run["t"] < run["dwells"]:
        lines.append(f"{run['reason'] or 'ended'} at dwell {run['t']} of {run['dwells']}")
    is_known = result.picture.get("gospa_km") is not None
    if any(row["p_d"] is not None for row in result.targets):
        lines.append(
            "intervals of P_D: Wilson, dwells of this one run as if independent; `cogradar campaign` gives them"
            " over runs"
        )
    elif not result.has_truth:
        lines.append("this run has no truth to compare with: P_D and errors are unknown")
    if is_known:
        lines.append(PICTURED.cell(result.picture))
    if result.picture.get("blind_cells"):
        lines.append(BLIND.cell(result.picture | {"blind_percent": 100.0 * result.picture["blind_share"]}))
    if result.picture.get("unmeasured_looks"):
        fault = result.picture.get("unmeasured_fault")
        lines.append(UNMEASURED.cell(result.picture) + (f"; the last time: {fault}" if fault else ""))
    missed = [str(row["target"]) for row in result.targets if row["born_t"] and not row["confirmed_t"]]
    if result.is_unknown and missed:
        lines.append(f"never followed: target {', '.join(missed)}")
    if any(row["lost"] for row in result.targets):
        lines.append("LOST: the track was out of its target's bin for the last 20 dwells, or for any 60 in a row")
    if result.false_tracks and not result.is_unknown:
        lines.append(
            f"false tracks: {result.false_tracks}; begun more than 1.5 angle bins from every target, by false alarms;"
            " the targets in their place have no track"
        )
    if pacing_at(run["rate_hz"]).has_deadlines:
        lines.append(_real_time(result))
        made_hz = (run["t"] + run["acquisition_scans"]) / result.elapsed_s
        if made_hz < SLOW * run["rate_hz"] and result.elapsed_s > SLOW_AFTER_S:
            lines.append(
                f"{made_hz:.1f} dwells a second were made of {run['rate_hz']:g}: the front end, or this machine, is"
                " slower"
            )
    return "\n".join([*lines, *conflict_warning(run["conflicts"])])


def run_digest(result: Result) -> str:
    """The line that others can compare."""
    return f"digest {result.run['digest'] or NO_DIGEST}"


def outcome(result: Result) -> str:
    """What happened, in a sentence or two: which targets kept their tracks, and how well they were seen."""
    scored = [row for row in result.targets if row["n"] and row["p_d"] is not None]
    if not scored:
        made, n = result.picture.get("dwells", result.run["t"]), result.run["t"]
        what = f"{n if made == n else f'{made} of {n}'} dwells were made"
        return f"{what}; no target was tracked." if result.has_truth else f"{what}."
    lost = [str(row["target"]) for row in scored if row["lost"]]
    n, verb = len(scored), "was" if len(lost) == 1 else "were"
    held = "The only target was" if n == 1 else f"All {n} targets were"
    what = f"{len(lost)} of {n} targets {verb} lost: {', '.join(lost)}." if lost else f"{held} tracked to the end."
    p_d = sorted(row["p_d"] for row in scored)
    errors = sorted(row["position_rmse_km"] for row in scored if row["position_rmse_km"] is not None)
    how = f"P_D {_span(p_d)}"
    return f"{what} {how}, position RMSE {_span(errors)} km." if errors else f"{what} {how}."


def _span(values: Sequence[float]) -> str:
    ends = [f"{values[0]:.3f}", f"{values[-1]:.3f}"]
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def next_step(program: str, result: Result, store: str | None, endpoint: str | None, url: str | None = None) -> str:
    """What to type next, ready to be pasted: about a store, or services at an endpoint, or HTTP if it is there."""
    run = result.run["run"]
    if store is not None and result.has_truth:
        is_whole = result.run["status"] == "complete" and result.picture.get("dwells") == result.run["t"]
        if is_whole:
            return f"next: {program} figures {quote(store)} --out figures"
        return f"next: {program} query summary --run {run} --store {quote(store)}"
    if store is not None:
        of_tracks = f"query tracks --run {run} --store {quote(store)}"
        if result.is_unknown:  # its rows are of targets
            of_tracks = f"export {run} --store {quote(store)} --out tracks.csv"
        return f"next: {program} {of_tracks}"
    if url is not None:
        return f"next: curl {url}/api/v1/runs/{run}/summary"
    if endpoint is not None:
        return f"next: {program} query tracks --run {run} --connect {endpoint}"
    return "next: nothing was kept; the same with --store FILE can be asked and drawn afterwards"


def _real_time(result: Result) -> str:
    """What did not come in time; in lockstep everything is waited for."""
    if not result.targets:
        return f"real time at {result.run['rate_hz']:g} Hz"
    late = ", ".join(f"T{row['target']} {100 * (row['late'] or 0.0):.2f} %" for row in result.targets)
    longest = max(result.targets, key=lambda row: int(row["n"]))
    stale = 100 * (longest["stale"] or 0.0)
    stored = f"{result.picture['dwells']} of {result.run['t']} dwells stored; "
    return f"real time at {result.run['rate_hz']:g} Hz: {stored}late plans {late}; stale waveforms {stale:.2f} %"


def _live(row: dict[str, Any]) -> str:
    """`T2 0.94 12.3km 15m/s`: P_D, position and velocity RMSE of a target."""
    return LIVE.cell(in_metres(row))


def _fitting(rows: Rows, room: int) -> str:
    """Targets in so many characters: all of them, or those with the least P_D and how many more there are."""
    worst = sorted(rows, key=lambda row: row["p_d"] or 0.0)
    for n in range(len(rows), 0, -1):
        chosen = [row for row in rows if row in worst[:n]]
        more = [] if n == len(rows) else [f"+{len(rows) - n} more"]
        if len(text := "  ".join([*map(_live, chosen), *more])) <= room:
            return text
    return ""
