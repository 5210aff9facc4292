"""The command about stores: copied, checked, and rid of a run."""

from enum import StrEnum
from typing import Annotated

import typer

from cogradar.services.cli import completion
from cogradar.services.cli.console import Stop, command, err, progress, say
from cogradar.services.errors import Damaged, check_stop
from cogradar.services.recorder.store.address import SHORT, shown
from cogradar.services.recorder.store.seal import beyond_cure, without_cure


class StoreAction(StrEnum):
    """What is to be done with stores."""

    COPY = "copy"
    CHECK = "check"
    DELETE = "delete"


def store_command(
    action: Annotated[
        StoreAction, typer.Argument(metavar="copy|check|delete", show_choices=False, help="What is done.")
    ],
    source: Annotated[str, typer.Argument(help=f"SQLite file, or {SHORT}.", autocompletion=completion.stores)],
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="[TARGET|RUN]",
            help="Of copy: a new file, or an empty schema of a server. Of delete: the run, as `query runs` shows it.",
        ),
    ] = None,
    intact: Annotated[bool, typer.Option("--intact", help="Of copy: leave out runs with a damaged row.")] = False,
) -> None:
    """Copy a store into a new one, from a file to a server, or back; check that
    all of it is as it was written; or delete one run from it.

    What is committed at this moment is checked, copied, read again and
    compared row by row. A copy that fails leaves an empty store, to which you
    can copy again. `check` names each damaged run, and its exit code is 2.
    `delete` needs a store that no process writes and a run that has ended. The
    file keeps its size: later runs use the space. After Ctrl-C the next
    recorder or `delete` deletes the rest.
    """
    if (target is None) is not (action is StoreAction.CHECK):
        raise typer.BadParameter("copy takes two stores, check takes one, delete a store and a run")
    if intact and action is not StoreAction.COPY:
        raise typer.BadParameter("--intact belongs to copy")
    with command() as stop:
        if target is None:
            _check_store(source, stop)
        elif action is StoreAction.DELETE:
            _delete_run(source, target, stop)
        else:
            _copy_store(source, target, stop, only_intact=intact)


def _check_store(source: str, stop: Stop) -> None:
    from cogradar.services.recorder.store.check import check

    n = 0
    with progress(err) as tell:

        def told(run: str) -> None:
            nonlocal n
            n += 1
            check_stop(stop)
            tell(f"{shown(source)}: run {n}, {run}")

        found = check(source, told)
    for one in found:
        say(without_cure(shown(source), one), err)
    if found and len({one.run for one in found if one.run}) == n:
        raise Damaged(beyond_cure(shown(source), f"{shown(source)}: is damaged"))
    if found:
        cure = f"`cogradar store copy --intact {shown(source)} NEW` saves the runs that are whole"
        raise Damaged(f"{shown(source)}: is damaged, as said above: {cure}")
    say(f"{shown(source)}: {n} runs, all as they were written")


def _delete_run(source: str, run: str, stop: Stop) -> None:
    from cogradar.services.recorder.delete import delete

    with progress(err) as tell:

        def told(n: int) -> None:
            check_stop(stop, f": run {run} is gone; the next recorder or `store delete` deletes the rest of it")
            tell(f"{shown(source)}: run {run}, {n} messages deleted")

        check_stop(stop)
        delete(source, run, told)
    say(f"{shown(source)}: run {run} is deleted")


def _copy_store(source: str, target: str, stop: Stop, *, only_intact: bool) -> None:
    from cogradar.services.recorder.store.copy import copy

    lost = list[Damaged]()
    try:
        counts = copy(source, target, lambda *_: check_stop(stop), only_intact=only_intact, left_out=lost.append)
    except Damaged as error:
        if not only_intact:
            raise
        raise Damaged(beyond_cure(shown(source), without_cure(shown(source), error))) from None
    for one in lost:
        say(f"left out: {without_cure(shown(source), one)}", err)
    say(f"{shown(target)}: {counts['run']} runs, {counts['message']} messages, {sum(counts.values())} rows in all")
