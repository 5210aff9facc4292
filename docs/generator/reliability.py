"""What holds the promises of docs/reliability.md: a command each, which prints the result that the page has.

`make reliability` plays the commands, of all parts or of some (ARGS="kills faults"), and rewrites their rows.
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

PAGE = Path(__file__).parents[1] / "reliability.md"
BEGIN, END = "<!-- proofs -->", "<!-- /proofs -->"
NOT_YET = "not played yet"
HEAD = ("part", "promise", "size", "result", "command")
COLUMNS = [f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD)]


def last_line(printed: str) -> str:
    """The last line, without a test runner's frame and without the time it took, which tells nothing."""
    return re.sub(r" in [\d.]+s( \([\d:]+\))?$", "", printed.strip().splitlines()[-1].strip("= "))


def _secured(printed: str) -> str:
    found = json.loads(printed)
    return f"a dwell takes {found['ratio']:.3f} [{found['low']:.3f} {found['high']:.3f}] of one without"


class Proof(NamedTuple):
    """A promise, and the command that would fail if it were broken."""

    part: str
    promise: str
    size: str
    command: str
    result: Callable[[str], str] = last_line


PYTEST = "pytest -q -m 'nightly or not nightly' "
PROOFS = (
    Proof(
        "kills",
        "Any process may be killed at any time: the run ends with the bytes of one left in peace.",
        "20 runs of 1 000 dwells, 20 kills a minute",
        "cogradar chaos",
    ),
    Proof(
        "kills-of-a-sky",
        "So may they while tracks begin, meet and end.",
        "10 runs of 120 dwells, two aircraft that were not announced to the radar",
        "cogradar chaos crossing --runs 10 --dwells 120",
    ),
    Proof(
        "kills-in-real-time",
        "In real time, too, any process may be killed: no confirmed track ends because of it.",
        "2 runs of 500 dwells at 4 a second, an unknown number of aircraft, 24 kills a minute",
        "cogradar chaos traffic --pace realtime --rate 4 --runs 2 --dwells 500 --kills 24",
    ),
    Proof(
        "kills-of-one-planner",
        "So it is with one planner.",
        "640 dwells at 4 a second, 14 kills a minute",
        "cogradar chaos traffic --pace realtime --rate 4 --runs 1 --dwells 640 --kills 14 --planners 1",
    ),
    Proof(
        "kills-of-two-planners",
        "So it is with two planners.",
        "480 dwells at 4 a second, 16 kills a minute",
        "cogradar chaos traffic --pace realtime --rate 4 --runs 1 --dwells 480 --kills 16 --planners 2"
        " --out docs/tables/reliability-kills.csv",
    ),
    Proof(
        "kills-of-three-planners",
        "So it is with three planners.",
        "480 dwells at 4 a second, 16 kills a minute",
        "cogradar chaos traffic --pace realtime --rate 4 --runs 1 --dwells 480 --kills 16 --planners 3",
    ),
    Proof(
        "faults",
        "Disks, links, processes and clocks may fail together, at any moment.",
        "100 000 schedules of one to eight faults",
        "cogradar simulate --schedules 100000",
    ),
    Proof(
        "strangers",
        "Without a certificate, or with another role's, a process has no effect.",
        "a table of attempts against a run, which ends with its digest",
        f"{PYTEST}tests/services/certs",
    ),
    Proof(
        "certificates",
        "Certificates and access control cost less than a twentieth of a dwell.",
        "20 pairs of runs of 60 dwells",
        "python -m studies secured --pairs 20 --json",
        _secured,
    ),
    Proof(
        "builds",
        "Processes of another build are not heard; a second metrics does not start; a run goes on after an upgrade.",
        "real processes",
        f"{PYTEST}tests/services/test_identity.py tests/services/runs/test_upgrade.py",
    ),
    Proof(
        "frozen",
        "A recorder that was frozen while another one took over ends itself; an emulator or allocator drops its runs"
        " and joins again; nothing that was acknowledged is lost.",
        "real processes, two of a role, stopped or killed during runs",
        f"{PYTEST}tests/services/test_deposed.py tests/services/runs/test_pools.py",
    ),
    Proof(
        "alone",
        "Of several recorders, or planners of one name, that start at once, one lives.",
        "50 starts of three real processes of each, up to 0.2 s apart",
        f"{PYTEST}tests/services/test_alone.py",
    ),
    Proof(
        "kills-of-a-writer",
        "A recorder and an export that are killed at any moment go on right.",
        "200 kills of each",
        f"{PYTEST}tests/services/test_killed.py",
    ),
    Proof(
        "full-disk",
        "A full disk holds runs in lockstep, stops no radar in real time, and all go on when there is room.",
        "a file system of its own, of some MiB",
        f"{PYTEST}tests/services/recorder/test_full_disk.py",
    ),
    Proof(
        "mutants",
        "No message ends a process, hangs it, or changes it by being refused.",
        "10 000 broken messages over all pairs of topic and reader",
        "pytest -q tests/robustness/test_messages.py",
    ),
    Proof(
        "bad-input",
        "No scenario, trajectory, recording or store does either; no numbers at their edges stop the loop.",
        "files and stores drawn at random; runs at the edges of what a scenario may ask for",
        "pytest -q tests/robustness/test_files.py tests/robustness/test_numbers.py",
    ),
    Proof(
        "questions",
        "No request over HTTP gets an answer that the service's description does not have.",
        "every parameter at its limits, 50 requests at random of each operation, and sequences of them",
        f"{PYTEST}tests/services/web/test_openapi.py",
    ),
    Proof(
        "flood",
        "What waits at a process is bounded; a flood of one topic takes no place of another.",
        "40 MiB of one topic, a router between",
        "pytest -q tests/shared/wire/test_zenoh_bus.py",
    ),
    Proof(
        "storm",
        "Many runs at once do not drown in redelivery.",
        "60 runs of 30 targets",
        f"{PYTEST}tests/services/test_storm.py",
    ),
    Proof(
        "hour",
        "An hour of containers in real time, with commands and kills, is replayed bit for bit.",
        "`docker compose up` at 5 dwells a second; 30 commands over HTTP and from the page; planner, allocator,"
        " recorder, router, emulator and metrics killed, one after the other",
        "python -m tests.containers.hour",
    ),
    Proof(
        "soak",
        "What a system holds does not grow, and every question is answered.",
        "30 minutes, 6 runs at a time, 20 pages, 50 askers",
        "python -m studies soak",
    ),
)


def page(text: str, results: dict[str, str]) -> str:
    """The page with new results; rows without one keep theirs."""
    before, _, rest = text.partition(BEGIN)
    old, _, after = rest.partition(END)
    cells = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in old.splitlines() if "|" in line]
    kept = {row[0]: row[3] for row in cells if len(row) == len(HEAD)}
    lines = [
        f"| {proof.part} | {proof.promise} | {proof.size} | {(kept | results).get(proof.part, NOT_YET)} |"
        f" `{proof.command}` |"
        for proof in PROOFS
    ]
    return "\n".join([before + BEGIN, "", *COLUMNS, *lines, "", END + after])


def played(proof: Proof) -> str:
    """Play a command, show what it prints, and return its result. Raises CalledProcessError if it fails."""
    sys.stdout.write(f"$ {proof.command}\n")
    done = subprocess.run(proof.command, shell=True, check=False, capture_output=True, text=True)  # noqa: S602 - from PROOFS
    sys.stdout.write(done.stdout + (done.stderr if done.returncode else ""))
    done.check_returncode()
    return f"{proof.result(done.stdout)} ({datetime.now(UTC):%Y-%m-%d})"


if __name__ == "__main__":
    chosen = sys.argv[1:] or [proof.part for proof in PROOFS]
    if unknown := set(chosen) - {proof.part for proof in PROOFS}:
        sys.exit(f"{min(unknown)}: must be one of {', '.join(proof.part for proof in PROOFS)}")
    for each in PROOFS:
        if each.part in chosen:
            PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), {each.part: played(each)}), encoding="utf-8")
