"""A report as tables, and as part of a page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cogradar.services.analysis.pages import first_run, write_into
from cogradar.services.analysis.tables import Column, Row, Table, check_page, in_metres
from cogradar.services.errors import BadInput
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.tables import marked

BESIDE = "side by side"  # marker of a page
INDEPENDENT = (
    "intervals: 95 % and 95 %, runs: bootstrap over whole runs, as a lost track misses all its dwells; 95 %, Wilson: "
    "single dwells (P_D), tracks (lost) or targets (never found) as if they were independent"
)

OF_ONE = "of a single run there is no interval over runs; Wilson's takes its dwells as independent, which they are not"


def _interval(name: str, form: str, heading: str = "95 %") -> Column:
    return Column(heading, f"{{{name}_low:{form}}} {{{name}_high:{form}}}")


TARGET = Column("target", "{target}", left=True)
STRATEGY = Column("strategy", "{strategy}", left=True)
DWELLS = Column("dwells", "{first_dwell}-{last_dwell}", left=True)
IN_BIN = Column("in bin", "{in_bin:.3f}")
DETECTION = (
    Column("P_D", "{p_d:.3f}"),
    _interval("p_d", ".3f", "95 %, runs"),
    _interval("p_d_wilson", ".3f", "95 %, Wilson"),
    Column("bin hits", "{hit_rate:.3f}"),
    IN_BIN,
    _interval("in_bin", ".3f", "95 %, runs"),
    Column("power", "{share:.3f}"),
)
ERRORS = (
    Column("RMSE km", "{position_rmse_km:.3f}"),
    _interval("position_rmse_km", ".3f"),
    Column("RMSE m/s", "{velocity_rmse_m_s:.1f}"),
    _interval("velocity_rmse_m_s", ".1f"),
)
IN_TIME = (
    *DETECTION[:2],
    Column("RMSE km", "{position_rmse_km:.2f}"),
    _interval("position_rmse_km", ".2f"),
    ERRORS[2],
)
DIFFERENCES = (
    Column("difference", "{strategy} - {minus}", left=True),
    Column("P_D", "{p_d:+.3f}"),
    _interval("p_d", "+.3f"),
    Column("RMSE km", "{position_rmse_km:+.2f}"),
    _interval("position_rmse_km", "+.2f"),
)
LOST = (
    Column("lost", "{lost} of {tracks}"),
    Column("lost, fraction", "{share:.3f}"),
    _interval("share", ".3f", "95 %, Wilson"),
    Column("dwells out, mean", "{outage:.1f}"),
    Column("longest", "{outage_longest}"),
)
OVERALL = (
    IN_BIN,
    _interval("in_bin", ".3f", "95 %, runs"),
    Column("tracks lost", "{lost} of {tracks}"),
    Column("lost, fraction", "{share:.3f}"),
    _interval("share", ".3f", "95 %, runs"),
)
ALL_TARGETS = (
    Column("GOSPA km", "{gospa_km:.3f}"),
    _interval("gospa_km", ".3f", "95 %, runs"),
    Column("of errors", "{gospa_localisation_km:.3f}"),
    Column("of missed", "{gospa_missed_km:.3f}"),
    Column("of false", "{gospa_false_km:.3f}"),
    Column("complete", "{completeness:.3f}"),
    _interval("completeness", ".3f", "95 %, runs"),
    Column("spurious", "{spuriousness:.3f}"),
    Column("swaps", "{swaps:.2f}"),
    Column("false tracks/h", "{false_tracks_per_hour:.2f}"),
)
BLIND = (
    Column("blind cells a run", "{blind_cells:.1f}"),
    Column("in dwells", "{blind_dwells:.1f}"),
    Column("share of the tested", "{blind_share:.2e}"),
    _interval("blind_share", ".2e", "95 %, runs"),
)
ANTENNAS = (
    Column("waveforms", "{n}"),
    Column("hottest over mean, dB", "{hottest_db:.2f}"),
    _interval("hottest_db", ".2f", "95 %, runs"),
    Column("largest PAPR, dB", "{papr_db:.2f}"),
    _interval("papr_db", ".2f", "95 %, runs"),
)
CONSISTENCY = (
    Column("runs", "{runs}"),
    Column("NEES, mean", "{nees:.2f}"),
    Column("position", "{nees_position:.2f}"),
    Column("velocity", "{nees_velocity:.2f}"),
    Column("in 95 % band", "{in_band:.3f}"),
    Column("beyond 99 %", "{beyond_99:.4f}"),
)
CONFIRMATION = (
    Column("confirmed s, median", "{confirmation_median_s:.1f}"),
    Column("confirmed s, 95 %", "{confirmation_95_s:.1f}"),
    Column("never found", "{never_found} of {long_visible}"),
    Column("never found, fraction", "{share:.3f}"),
    _interval("share", ".3f", "95 %, Wilson"),
)
FLIGHT_TABLE = (
    Column("acceleration", "{flight}", left=True),
    Column("target dwells", "{n}"),
    Column("NEES, mean", "{nees:.2f}"),
    _interval("nees", ".2f", "95 %, runs"),
    Column("position", "{nees_position:.2f}"),
    Column("velocity", "{nees_velocity:.2f}"),
    Column("beyond 99 %", "{beyond_99:.4f}"),
)
ACQUISITION = (
    Column("runs", "{runs}"),
    Column("scans, mean", "{mean:.1f}"),
    _interval("mean", ".1f"),
    Column("median", "{median:.1f}"),
    Column("most", "{max}"),
)


def tables(report: dict[str, Any]) -> list[Table]:
    """The tables of a report, the last ones a target each, with a row per window of dwells."""
    last = report["last"]
    span = f"dwells {last[0]['first_dwell']}-{last[0]['last_dwell']}"
    made = [
        _table(f"Detection, {span}", (TARGET, STRATEGY, *DETECTION), last, "target"),
        _table(f"Errors of the belief mean, {span}", (TARGET, STRATEGY, *ERRORS), last, "target"),
        _table(f"Differences within a seed, {span}", (TARGET, *DIFFERENCES), report["differences"], "target"),
        _table("Lost tracks and outages", (TARGET, STRATEGY, *LOST), report["lost"], "target"),
        _table("All targets and dwells", (STRATEGY, *OVERALL), report["overall"]),
        _table("Air picture, all dwells", (STRATEGY, *ALL_TARGETS), report["picture"]),
        _table("Cells whose noise had no estimate", (STRATEGY, *BLIND), _blind(report["picture"])),
        _table("NEES of the beliefs, 4 states", (TARGET, STRATEGY, *CONSISTENCY), report["consistency"], "target"),
        _table("NEES of all targets by acceleration", (STRATEGY, *FLIGHT_TABLE), report["flights"], "strategy"),
        _table("From visible to confirmed, all targets", (STRATEGY, *CONFIRMATION), report["confirmation"]),
        _table("Transmit antennas, stored waveforms", (STRATEGY, *ANTENNAS), report["antennas"]),
        _table("Acquisition", (STRATEGY, *ACQUISITION), report["acquisition"]),
    ]
    for target in dict.fromkeys(row["target"] for row in last):
        rows = [row for row in report["windows"] if row["target"] == target]
        made.append(_table(f"Target {target} in time", (DWELLS, STRATEGY, *IN_TIME), rows, "first_dwell"))
    return [table for table in made if table.rows]


def side_by_side(reports: Sequence[dict[str, Any]]) -> list[Table]:
    """What several experiments with the same targets come to, a row per target, strategy and experiment."""
    tables = []
    for i, what in ((-1, "the last dwells"), (0, "all dwells")):
        rows = [
            row | {"what": f"{report['scenario']} ({report['fidelity']})"}
            for report in reports
            for row in (report["last"] if i else _of_whole_runs(report))
        ]
        order = {strategy: i for i, strategy in enumerate(Strategy)}
        rows.sort(key=lambda row: (row["target"], order.get(row["strategy"], len(order)), row["strategy"]))
        columns = (TARGET, STRATEGY, Column("scenario", "{what}", left=True), DWELLS, *DETECTION[:2], *ERRORS)
        tables.append(_table(f"Side by side, {what}", columns, rows, "target"))
    return tables


def _blind(picture: Sequence[Row]) -> list[Row]:
    """Strategies with blind cells."""
    return [row for row in picture if row["blind_cells"]]


def _of_whole_runs(report: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for row in report["windows"] if (row["first_dwell"], row["last_dwell"]) == (1, report["dwells"])]


def heading(report: dict[str, Any]) -> str:
    """What the report is of: scenario and title, which are the values of a variant of a sweep."""
    return f"{report['scenario']}: {report['title']}"


def verdict(report: dict[str, Any]) -> str:
    """What the runs show, in a sentence or two: tracks that were lost, and the target whose P_D differs most."""
    lost = [
        f"{row['strategy']} lost {row['lost']} of {row['tracks']} tracks in {_runs(row['runs'])}"
        for row in report["overall"]
    ]
    said = [", ".join(lost)] if lost else []
    known = [row for row in report["differences"] if row["p_d_low"] is not None]
    for pair in dict.fromkeys((row["strategy"], row["minus"]) for row in known):
        rows = [row for row in known if (row["strategy"], row["minus"]) == pair]
        clear = [row for row in rows if not row["p_d_low"] <= 0.0 <= row["p_d_high"]]
        of = f"{pair[0]} - {pair[1]}, dwells {rows[0]['first_dwell']}-{rows[0]['last_dwell']}, {_runs(rows[0]['runs'])}"
        if not clear:
            said.append(f"{of}: no target's P_D differs beyond its interval")
            continue
        most = max(clear, key=lambda row: abs(row["p_d"]))
        interval = f"[{most['p_d_low']:+.3f}, {most['p_d_high']:+.3f}]"
        said.append(f"{of}: P_D of target {most['target']} differs most, {most['p_d']:+.3f} {interval}")
    return ". ".join(said)


def _runs(n: int) -> str:
    return f"{n} run{'s' * (n != 1)}"


def caption(report: dict[str, Any]) -> str:
    """Which runs it is of, and what its intervals are."""
    runs = ", ".join(f"{n} {strategy}" for strategy, n in report["runs"].items())
    is_one = list(report["runs"].values()) == [1]
    what = f"{report['scenario']} ({report['fidelity']}): {runs} run{'s' * (not is_one)} of {report['dwells']} dwells"
    lines = [marked(what, report["rule"])]
    intervals = INDEPENDENT if max(report["runs"].values()) > 1 else OF_ONE
    digest = f"digest {report['digest']}, of the results of all these runs together"
    if report["failed"]:
        lines.append(f"{len(report['failed'])} runs failed, the first: {report['failed'][0]['reason']}")
    return "\n".join([*lines, *conflict_warning(report["conflicts"]), intervals, digest])


def write(page: Path, reports: Sequence[dict[str, Any]]) -> None:
    """Replace what is between the markers of each scenario, `<!-- report NAME -->` and `<!-- /report NAME -->`.

    Of several reports a comparison, too, where the page has `<!-- side by side -->`. All of them or none. Raises
    BadInput if the page has no markers of a scenario, or two reports are of one scenario.
    """
    names = [report["scenario"] for report in reports]
    if len(set(names)) < len(names):
        raise BadInput(f"several experiments of one scenario ({', '.join(names)}): choose one with --seed or --run")
    blocks: dict[str, Sequence[str | Table]] = {
        f"report {report['scenario']}": [
            f"```\n{caption(report)}\n```",
            *tables(report),
            *([first_run(report["first"], report["scenario"])] if report["first"] is not None else []),
        ]
        for report in reports
    }
    if len(reports) > 1 and f"<!-- {BESIDE} -->" in check_page(page, list(blocks)):
        blocks |= {BESIDE: side_by_side(reports)}
    write_into(page, blocks)


def conflict_warning(conflicts: int) -> list[str]:
    """A line if processes that should have sent the same did not: different processors or versions of the program."""
    warning = f"WARNING: {conflicts} messages differed from those that other processes sent for the same dwell"
    return [warning] if conflicts else []


def _table(title: str, columns: Sequence[Column], rows: Sequence[Row], group: str = "") -> Table:
    """A table with the columns that have values: a single run has no intervals."""
    shown = [in_metres(row) for row in rows]
    return Table(title, [c for c in columns if any(c.cell(row).strip("- ") for row in shown)], shown, group)
