"""A file to begin with, and what is wrong with one."""

from pathlib import Path
from typing import Annotated

import typer

from cogradar.services.cli import completion
from cogradar.services.cli.console import command, err, new_file, out, progress, say
from cogradar.services.errors import BadInput, RunFailed


def new(
    kind: Annotated[
        str,
        typer.Argument(
            help="rule, belief, strategy, objective, disturbance, front-end or feed.", autocompletion=completion.kinds
        ),
    ],
    file: Annotated[Path, typer.Argument(callback=new_file, help="The file to write, NAME.py.")],
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Write a first version of a plug-in; it runs as it is."""
    from cogradar.services.plugins import templates

    with command(at_once=True):
        words = templates.write(kind, file, force=force)
    say(f"{file}: {words.replace('`', '')}")
    say(f"check it: cogradar check {file}")


def is_of_author(text: str) -> bool:
    """Whether what is to be checked is a thing of somebody's own, and not a scenario."""
    return text.partition("#")[0].endswith(".py") or (":" in text and not text.endswith(".toml"))


def check_own(text: str, kind: str | None) -> None:
    """Check a thing of somebody's own, and print what is found; exit code 1 if something is wrong."""
    from cogradar.services import kernels
    from cogradar.services.analysis.tables import Column, Table
    from cogradar.services.cli.terminal import print_tables
    from cogradar.services.front_ends import ZENOH, settled
    from cogradar.services.plugins import kit
    from cogradar.services.recorder.store.address import RECORDED

    with command(at_once=True) as stop:
        if text.startswith((ZENOH, RECORDED)):
            name = settled(text)
            raise BadInput(f"{text}: only a run can ask it: cogradar run SCENARIO --front-end '{name}' --dwells 20")
        kernels.compile_all(say, stop)
        with progress(err, each_s=0.0) as show:
            found = kit.check(text, kind, show)
    columns = (
        Column("", "{name}", left=True),
        Column("check", "{check}", left=True),
        Column("", "{mark}", left=True),
        Column("found", "{found}", left=True, wraps=True),
    )
    rows = [{**one._asdict(), "mark": "ok" if one.ok else "wrong"} for one in found]
    wrong = [f"{one.name}: {one.check}: {one.found}" for one in found if not one.ok]
    print_tables(out, [Table("", columns, rows, "name")])
    for line in wrong:
        out.print(line, soft_wrap=True)
    if wrong:
        raise typer.Exit(RunFailed.exit_code)
