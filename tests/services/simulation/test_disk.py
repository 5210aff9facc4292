"""The simulated disk: what a crash leaves of a commit."""

import pytest

from cogradar.services.simulation.disk import Disk, PowerCut
from cogradar.services.simulation.skies import start_of
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import RunEnd


def test_a_torn_commit_is_there_or_not() -> None:
    """Whatever part of the log is there, SQLite finds the whole transaction or none of it."""
    kept = set()
    for seed in range(40):
        disk = Disk(generator(seed, Purpose.FAULT, -1, 2))
        journal = disk.open(lambda _: None)
        journal.add_run(start_of("known", 1, 0.0))
        journal.commit()
        disk.cuts_power = True
        journal.end_run(RunEnd(run="known-1", k=0, t=0, status="complete"), "digest")
        with pytest.raises(PowerCut):
            journal.commit()
        disk.crash(torn=True)
        (row,) = disk.open(lambda _: None).read("SELECT status, digest FROM run")
        kept.add((row["status"], row["digest"]))
        disk.close()
    assert kept == {("running", None), ("complete", "digest")}
