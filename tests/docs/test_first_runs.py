"""The tables of the pages are of this program: the run that each of them says to repeat is played, bit for bit."""

import re
import shlex
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

import cogradar

DOCS = Path(__file__).parents[2] / "docs"
_BLOCK = re.compile(r"<!-- ((?:sweep|report) \S+) -->(.*?)<!-- /\1 -->", re.DOTALL)
_RUN = re.compile(r"The first of these runs is `cogradar run ([^`]*)`, digest `([0-9a-f]{16})`\.")
EARLIER = "An earlier program made"  # what a page says of tables that were not made anew: these
MADE_EARLIER: dict[str, set[str]] = {}


class Block(NamedTuple):
    """Tables between two markers of a page."""

    page: str
    name: str
    text: str


BLOCKS = [
    Block(page.name, *found)
    for page in sorted(DOCS.glob("*.md"))
    for found in _BLOCK.findall(page.read_text(encoding="utf-8"))
]
REPEATED = [block for block in BLOCKS if _RUN.search(block.text)]
SHORTEST = {  # played each time
    "array.md": "sweep jammer",
    "beyond.md": "sweep looks",
    "results.md": "report paper",
    "skies.md": "sweep crossing",
}


def test_tables_say_which_run_repeats_them_or_that_they_are_of_an_earlier_program() -> None:
    earlier = {(page, f"sweep {name}") for page, names in MADE_EARLIER.items() for name in names}
    assert {(block.page, block.name) for block in BLOCKS if block not in REPEATED} == earlier
    assert set(SHORTEST.items()) <= {(block.page, block.name) for block in REPEATED}
    for page in MADE_EARLIER:
        assert EARLIER in " ".join((DOCS / page).read_text(encoding="utf-8").split()), page


@pytest.mark.parametrize(
    "block",
    [
        pytest.param(block, id=block.name, marks=() if SHORTEST.get(block.page) == block.name else pytest.mark.nightly)
        for block in REPEATED
    ],
)
def test_the_run_that_a_table_names_is_what_this_program_plays(block: Block) -> None:
    (found,) = _RUN.findall(block.text)
    scenario, _, *words = shlex.split(found[0])
    settings = [value for name, value in zip(words[::2], words[1::2], strict=True) if name == "--set"]
    given = {name: value for name, value in zip(words[::2], words[1::2], strict=True) if name != "--set"}
    if scenario.startswith("build/"):  # made of a package's data
        subprocess.run(["make", scenario], cwd=DOCS.parent, check=True, capture_output=True)
    loaded = cogradar.load(scenario, settings)
    strategy, seed, dwells = given["--strategy"], int(given["--seed"]), int(given["--dwells"])
    digest = cogradar.run(loaded, strategy=strategy, seed=seed, dwells=dwells).digest
    assert digest.startswith(found[1]), f"docs/{block.page} was made by another program: cogradar run {found[0]}"
