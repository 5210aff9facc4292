"""The command line of the studies of an array's world: `python -m studies.array NAME`."""

from pathlib import Path
from typing import Annotated

import typer

from cogradar.services.analysis.pages import write_into
from cogradar.services.analysis.tables import Table, check_page
from cogradar.services.cli.console import call, command, out, progress
from cogradar.services.cli.terminal import print_tables

app = typer.Typer(
    name="python -m studies.array",
    help="What docs/array.md reports beyond sweeps. Some minutes each at most.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

IntoOption = Annotated[Path | None, typer.Option(help="Markdown page whose table to rewrite, between markers.")]
StoreArgument = Annotated[str, typer.Argument(help="Store of a sweep.")]


def _show(found: list[Table], name: str, into: Path | None) -> None:
    if into:
        write_into(into, {name: found})
    print_tables(out, found)


@app.command()
def antennas(into: IntoOption = None) -> None:
    """Measure what equal antennas cost, in dB below the optimum of the sum."""
    from cogradar.services import kernels
    from studies.array import antennas as study

    with command() as stop:
        if into:
            check_page(into, ["antennas"])
        kernels.compile_all(lambda text: out.print(text, soft_wrap=True), stop)
        _show([study.table(study.measure())], "antennas", into)


@app.command()
def noise(
    recording: Annotated[Path, typer.Option(help="Where the stand-in for recorded I/Q is written, a .npy file.")],
    dwells: Annotated[int, typer.Option(min=10, max=100_000, help="Of 64 range cells.")] = 800,
    into: IntoOption = None,
) -> None:
    """Measure false alarms and detections of each estimate of the noise on recorded I/Q."""
    from studies.array import noise as study

    with command() as stop:
        if into:
            check_page(into, ["noise"])
        with progress(out) as tell:
            rows = study.measure(recording, dwells, tell, stop)
        _show([study.table(rows)], "noise", into)


@app.command()
def blind(into: IntoOption = None) -> None:
    """Count the bins that a jammer leaves without an estimate of the noise, and the targets detected beside it."""
    from studies.array import jammer as study

    with command():
        if into:
            check_page(into, ["blind"])
        _show(study.tables(study.measure()), "blind", into)


@app.command()
def heights(store: StoreArgument, into: IntoOption = None) -> None:
    """Tabulate NEES and RMSE on the ground, of a sweep over radar.assumes.height_max_km."""
    from studies.array import heights as study

    with command(at_once=True):
        _show([study.table(study.measure(store))], "heights", into)


@app.command()
def worlds(
    store: StoreArgument,
    file: Annotated[Path, typer.Option("--out", help="Figure, without a suffix: PNG and PDF.")],
) -> None:
    """Draw P_D and errors against time in both worlds, of a sweep over world.signal."""
    from studies.array import worlds as study

    with command(at_once=True):
        for drawn in study.draw(store, file):
            out.print(str(drawn), soft_wrap=True)


if __name__ == "__main__":
    call(app)
