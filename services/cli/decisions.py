"""The command that compares the rules of looking."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.analysis.tables import check_page
from services.cli.console import DwellsOption, ScenarioArgument, Stop, command, out, progress, say
from services.cli.studies import WorkersOption

if TYPE_CHECKING:
    from services.sweeps.decisions import Plan, Result

COSTS = ("pomcp", "exact", "mode", "mean")  # cases of `cogradar bench`


def decisions(
    results: Annotated[Path, typer.Option(dir_okay=False, help="JSON lines, a run a line; new runs are added.")],
    scenario: ScenarioArgument = "paper",
    runs: Annotated[int, typer.Option(min=1, help="Runs of each rule and setting at the scenario's SNR.")] = 100,
    weak_runs: Annotated[int, typer.Option(min=0, help="... and 3 and 6 dB below it.")] = 30,
    belief_runs: Annotated[int, typer.Option(min=0, help="Runs whose decisions are looked into one by one.")] = 3,
    dwells: DwellsOption = None,
    workers: WorkersOption = None,
    into: Annotated[str | None, typer.Option(help="Markdown file to rewrite between its markers.")] = None,
    as_is: Annotated[bool, typer.Option("--as-is", help="Play nothing: show what there is.")] = False,
) -> None:
    """Compare the rules of looking: detection, losses, and what a decision costs, with intervals over runs.

    Every rule plays the same seeds with two fidelities, at three SNRs and
    two accelerations of the targets: some hours. An interrupted comparison
    goes on with what its file has. Runs of another version of the program
    count as long as this version plays some of them to the same results.
    """
    from services.cli.terminal import print_tables
    from services.sweeps import decision_page, decision_runs
    from services.sweeps.decisions import Plan, Played, losses
    from shared.scenario.tables import BIN_RULES

    with command() as stop:
        if into:
            check_page(Path(into), [decision_page.MARK])
        plan = Plan(scenario, runs, weak_runs, belief_runs, dwells)
        found = decision_runs.of_plan(plan, results) if as_is else _play(plan, results, workers, stop)
        played, lost, costs = Played(found), losses(found, list(BIN_RULES)), _costs(stop)
        if into:
            decision_page.write(Path(into), plan, played, lost, costs)
    print_tables(out, decision_page.tables(played, lost, costs))
    say("\n".join(decision_page.words(plan, played, lost, costs)))


def _play(plan: "Plan", results: Path, workers: int | None, stop: Stop) -> "list[Result]":
    """Play what is not there yet."""
    from services import kernels
    from services.campaigns.pool import LocalPool, n_core
    from services.sweeps import decision_runs

    with progress(out) as tell:
        kernels.compile_all(tell, stop)
        return decision_runs.play(plan, results, LocalPool(workers or n_core()), tell=tell, stop=stop)


def _costs(stop: Stop) -> list[dict[str, Any]]:
    """What a decision costs by each rule, now, on this machine."""
    from services import kernels
    from services.bench import cases

    kernels.compile_all(say, stop)
    timed = cases.bench(COSTS)
    return [
        {"case": name, "what": cases.CASES[name].what, "median_ms": timing.median_ms}
        | {"loops": timing.median_ms / timed.reference_ms}
        for name, timing in timed.cases.items()
    ]
