"""The comparison of rules as a page: tables, and two sentences that are made from their numbers."""

from collections.abc import Sequence
from pathlib import Path

from services.analysis.tables import Column, Row, Table, markdown, write_into
from services.sweeps.decisions import SEARCH, SHOWN, SNRS_DB, Plan, Played, Rows, Setting

MARK = "decisions"  # of the page's markers
COUNTING = "mode"  # the rule without a search


def _interval(name: str, form: str) -> Column:
    return Column("95 %", f"{{{name}_low:{form}}} {{{name}_high:{form}}}")


_WHERE = (Column("fidelity", "{fidelity}", left=True), Column("sigma_s", "{sigma_s:g}"))
_RULE = Column("rule", "{name}", left=True)
_DETECTION = (
    *(*_WHERE, _RULE, Column("runs", "{runs}"), Column("least detected", "{worst}")),
    *(Column("P_D of it", "{p_d_worst:.4f}"), _interval("p_d_worst", ".4f")),
    *(Column(f"P_D of target {SHOWN}", "{p_d:.4f}"), _interval("p_d", ".4f")),
    *(Column("last 20", "{p_d_last:.3f}"), _interval("p_d_last", ".3f"), Column("lost", "{lost} of {tracks}")),
)
_DIFFERENCES = (
    *(*_WHERE, _RULE, Column("pairs", "{runs}")),
    *(Column(f"target {SHOWN}", "{p_d:+z.4f}"), _interval("p_d", "+z.4f")),
    *(Column("last 20", "{p_d_last:+z.3f}"), _interval("p_d_last", "+z.3f")),
    *(Column("all targets", "{p_d_all:+z.4f}"), _interval("p_d_all", "+z.4f")),
)
_LOSSES = (
    *(Column("SNR dB", "{snr_db:+g}"), *_WHERE, _RULE, Column("runs", "{runs}"), Column("decisions", "{decisions}")),
    *(Column("open, depth 2", "{open_percent:.2f} %"), Column("any horizon", "{open_any_percent:.2f} %")),
    *(Column("loss in Q, 1e-3", "{loss:.3f}"), Column("of the open ones", "{loss_open:.2f}")),
)
_COSTS = (
    *(Column("case", "{case}", left=True), Column("what", "{what}", left=True)),
    *(Column("reference loops", "{loops:.3f}"), Column("ms here", "{median_ms:.3f}")),
)


def tables(played: Played, losses: Rows, costs: Rows) -> list[Table]:
    """Detection and differences for each SNR, decisions, costs."""
    made = []
    for snr_db in SNRS_DB:
        at = "at the scenario's SNR" if snr_db == 0.0 else f"at {snr_db:+g} dB"
        made.append(Table(f"Detection {at}", _DETECTION, played.detection(snr_db), "sigma_s"))
        made.append(Table(f"P_D less that of {SEARCH} {at}", _DIFFERENCES, played.differences(snr_db), "sigma_s"))
    shown = [row | {f"{key}_percent": 100.0 * row[key] for key in ("open", "open_any")} for row in losses]
    made.append(Table("Decisions, on the beliefs that the search met", _LOSSES, shown, "sigma_s"))
    made.append(Table("Cost of one decision", _COSTS, costs))
    return [table for table in made if table.rows]


def words(plan: Plan, played: Played, losses: Rows, costs: Rows) -> list[str]:
    """What the numbers say: two sentences, and which runs they are of."""
    compared = [row for snr_db in SNRS_DB for row in played.differences(snr_db)]
    return [*_verdict(compared, losses, costs), _basis(plan, played)]


def _verdict(compared: Rows, losses: Rows, costs: Rows) -> list[str]:
    counting = [row for row in compared if row["rule"] == COUNTING and row["p_d_low"] is not None]
    if not counting:
        return ["There are too few runs to compare."]
    worse = [row for row in counting if row["p_d_high"] < 0.0]
    better = [row for row in counting if row["p_d_low"] > 0.0]
    own = next((row for row in counting if row["fidelity"] == "robust"), counting[0])
    n = len(counting)
    first = (
        f"In {len(worse)} of {n} setting{'s' * (n != 1)} the most probable bin detects target {SHOWN} less often than"
        f" the search, and in {len(better)} more often; where neither is so, the interval of the difference holds 0,"
        f" and at the scenario's own setting ({own['fidelity']}, {own['runs']} seeds) the difference is {_number(own)}."
    )
    mine = [row for row in compared if _is_at(row, own) and row["p_d_low"] is not None]
    differences = [
        f"{_number(row)} by {said}"
        for rule, said in (
            ("exact", "the exact depth-2 value"),
            ("oracle", "who knows the truth"),
            ("mean", "the bin of the mean"),
        )
        for row in mine
        if row["rule"] == rule
    ]
    parts = [
        f"the most probable bin is provably the best for {100.0 * (1.0 - row['open']):.1f} % of its decisions"
        ", as far as two looks go"
        for row in [row for row in losses if _is_at(row, own)][:1]
    ]
    parts += [f"what is detected more than by the search is {', '.join(differences)}"] if differences else []
    loops = {row["case"]: row["loops"] for row in costs}
    if {SEARCH, COUNTING} <= set(loops):
        parts.append(f"a decision by search costs {loops[SEARCH] / loops[COUNTING]:.0f} times one by counting")
    return [first + (f" There, {'; '.join(parts)}." if parts else "")]


def _is_at(row: Row, other: Row) -> bool:
    """Whether two rows are of one setting."""
    return all(row[key] == other[key] for key in Setting._fields)


def _number(row: Row) -> str:
    return f"{row['p_d']:+z.4f} [{row['p_d_low']:+z.4f} {row['p_d_high']:+z.4f}]"


def _basis(plan: Plan, played: Played) -> str:
    """How many runs there are of each setting and rule, how many there are to be, and of which program."""
    parts = []
    for snr_db in SNRS_DB:
        numbers = [row["runs"] for row in played.detection(snr_db)]
        of = f"of {plan.of(snr_db)} runs of each of {len(numbers)} cells"
        said = f"{_span(numbers)} {of}" if numbers else "nothing yet"
        parts.append(f"{said} at {snr_db:+g} dB")
    if played.n_failed:
        parts.append(f"{played.n_failed} more failed")
    programs = f"Program{'s' * (len(played.programs) != 1)} {', '.join(played.programs)}"
    return f"Played: {'; '.join(parts)}. {programs}."


def _span(numbers: Sequence[int]) -> str:
    return f"{min(numbers)}" if min(numbers) == max(numbers) else f"{min(numbers)} to {max(numbers)}"


def write(page: Path, plan: Plan, played: Played, losses: Rows, costs: Rows) -> None:
    """Rewrite the page between its markers. Raises BadInput if it has none."""
    write_into(page, {MARK: [*words(plan, played, losses, costs), *map(markdown, tables(played, losses, costs))]})
