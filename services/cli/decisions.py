"""The command that compares the rules of looking."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.analysis.tables import check_page
from services.cli.console import DwellsOption, ScenarioArgument, Stop, command, out, progress, say
from services.cli.studies import ResultsOption, ResumeOption, WorkersOption
from services.cli.studies import play as play_campaign

if TYPE_CHECKING:
    from services.metrics.store import Store
    from services.sweeps.decisions import Plan

COSTS = ("pomcp_literal", "pomcp", "exact", "mode", "mean")  # cases of `cogradar bench`


def decisions(
    store: ResultsOption,
    scenario: ScenarioArgument = "paper",
    runs: Annotated[int, typer.Option(min=0, help="Runs of each rule and setting at the scenario's SNR.")] = 100,
    weak_runs: Annotated[int, typer.Option(min=0, help="... and 3 and 6 dB below it.")] = 30,
    belief_runs: Annotated[int, typer.Option(min=0, help="Runs whose decisions are looked into one by one.")] = 3,
    dwells: DwellsOption = None,
    workers: WorkersOption = None,
    resume: ResumeOption = False,
    into: Annotated[str | None, typer.Option(help="Markdown file to rewrite between its markers.")] = None,
    as_is: Annotated[bool, typer.Option("--as-is", help="Play nothing: show what there is.")] = False,
) -> None:
    """Compare the rules of looking: detection, losses, and what a decision costs, with intervals over runs.

    Every rule plays the same seeds with two fidelities, at three SNRs and
    two accelerations of the targets: some hours. Runs at lower SNR are in a
    file beside the store, and so are the decisions of single runs.
    """
    from services.cli.terminal import print_tables
    from services.sweeps import beliefs, decision_page
    from services.sweeps.decisions import Plan, Played, beside

    with command() as stop:
        if into:
            check_page(Path(into), [decision_page.MARK])
        file = beside(store, "-beliefs.json")
        if not as_is:
            _play(Plan(scenario, runs, weak_runs, belief_runs, dwells), store, file, workers, stop, resume=resume)
        with ExitStack() as opened:
            played = Played(scenario, _opened(store, opened))
            losses = beliefs.rows(beliefs.read(file).get("runs", {}))
            costs = _costs(stop)
            if into:
                decision_page.write(Path(into), played, losses, costs)
            made, said = decision_page.tables(played, losses, costs), decision_page.words(played, losses, costs)
    print_tables(out, made)
    say("\n".join(said))


def _play(plan: "Plan", store: str, file: Path, workers: int | None, stop: Stop, *, resume: bool) -> None:
    """Play what is not there yet: at first what is looked into, then the campaigns."""
    from services import kernels
    from services.campaigns.pool import LocalPool, n_core
    from services.sweeps import beliefs
    from services.sweeps.decisions import campaigns

    with progress(out) as tell:
        kernels.compile_all(tell, stop)
        beliefs.play(plan, file, LocalPool(workers or n_core()), report=tell, stop=stop)
    for path, asked in campaigns(plan, store).items():
        play_campaign(asked, path, workers, None, stop, resume=resume).close()


def _opened(store: str, stack: ExitStack) -> "list[Store]":
    """The stores that are there."""
    from services.metrics.client import open_store
    from services.sweeps.decisions import stores

    paths = [path for path in stores(store) if Path(path).exists()] or [store]
    return [stack.enter_context(closing(open_store(path))) for path in paths]


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
