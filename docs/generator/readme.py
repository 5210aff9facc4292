"""Writes the table of results in README.md, from docs/results.md: `python -m docs.generator.readme`."""

import re
from pathlib import Path

from docs.generator.markdown import table

REPOSITORY = Path(__file__).resolve().parents[2]
README, RESULTS = REPOSITORY / "README.md", REPOSITORY / "docs" / "results.md"
TARGET = "2"  # the weakest
ALGORITHMS = {"paper-literal": "published", "paper": "robust", "paper-best": "best"}
BEAMS = {"uniform": "equal beams", "power-aware": "power-aware beams"}
# What the paper states of its weakest target, in its abstract.
PAPER = [
    ("the paper", "equal beams", "", "about 0.6", "", ""),
    ("the paper", "power-aware beams", "", "nearly 0.9", "", ""),
]
HEAD = ("algorithm", "waveform", "runs", "P_D of target 2", "RMSE, km", "tracks lost, of all")
_MARKED = re.compile(r"(<!-- results -->\n).*(<!-- /results -->)", re.DOTALL)


def results() -> str:
    """The table: target 2 in the last twenty dwells, tracks lost of all targets."""
    page = RESULTS.read_text(encoding="utf-8")
    last = page.partition("**Side by side, the last dwells**")[2].partition("\n**")[0]
    rows = [
        [cell.strip() for cell in line.strip("| \n").split("|")]
        for line in last.splitlines()
        if line.startswith(f"| {TARGET} ")
    ]
    found = {(row[2].split()[0], row[1]): row for row in rows}
    shown = []
    for scenario, algorithm in ALGORITHMS.items():
        report = page.partition(f"<!-- report {scenario} -->")[2].partition("<!-- /report")[0]
        lost = report.partition("**All targets and dwells**")[2].partition("\n**")[0]
        for strategy, beams in BEAMS.items():
            if (row := found.get((scenario, strategy))) is None:
                continue
            (runs,) = re.findall(rf"(\d+) {strategy}", report.partition("runs of")[0])
            tracks = _lost(lost, strategy)
            shown.append((algorithm, beams, runs, row[3], row[4], tracks))
    return table(HEAD, [*PAPER, *shown])


def with_results(readme: str) -> str:
    """The README with this table between its marks."""
    return _MARKED.sub(lambda marks: f"{marks[1]}{results()}\n{marks[2]}", readme)


def _lost(table: str, strategy: str) -> str:
    """Tracks lost by a strategy: in its row, or said of all rows."""
    row = "\n".join(line for line in table.splitlines() if line.startswith(f"| {strategy} |"))
    found: list[str] = re.findall(r"\d+ of \d+", row) or re.findall(r"\d+ of \d+", table)
    return found[0]


if __name__ == "__main__":
    README.write_text(with_results(README.read_text(encoding="utf-8")), encoding="utf-8")
