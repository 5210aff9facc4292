"""What Sphinx lacks here: generated parts, formulas without a script, notebooks, our docstrings."""

import json
import re
from collections.abc import Callable
from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from myst_parser.parsers.sphinx_ import MystParser
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from docs.generator import messages, numbers, programs, scenario, wire

PARTS: dict[str, Callable[[], str]] = {
    "scenario keys": scenario.keys,
    "strategies": scenario.strategies,
    "action-selection policies": scenario.bin_rules,
    "fidelities": scenario.fidelities,
    "objectives": scenario.objectives,
    "supported radars": scenario.radars,
    "supported looks": scenario.looks,
    "topics": messages.topics,
    "senders and readers": messages.readers,
    "other keys": messages.keys,
    "messages": messages.messages,
    "parts of messages": messages.parts,
    "a message in hex": wire.example,
    "limits of messages": wire.limits,
    "rights": wire.rights,
    "commands": programs.commands,
    "page keys": programs.page_keys,
    "paths": programs.paths,
    "answers": programs.answers,
    "store": numbers.store,
    "store version": numbers.store_version,
    "metrics": numbers.metrics,
}
PART = re.compile(r"^\*Generated: (.*)\. `make docs` fills it in\.\*$", re.MULTILINE)  # seen in a clone


def generated(text: str) -> str:
    """A page with what the program says of itself in place of its marks. Raises KeyError for an unknown part."""
    return PART.sub(lambda mark: PARTS[mark[1]](), text)


class NotebookParser(MystParser):
    """A notebook as a page: its texts, and its code as code."""

    supported = ("notebook",)

    def parse(self, inputstring: str, document: nodes.document) -> None:
        """Parse the cells as one Markdown page."""
        super().parse(as_markdown(inputstring), document)


def as_markdown(notebook: str) -> str:
    """The cells of a notebook, one below the other."""
    cells = ((cell["cell_type"], "".join(cell["source"])) for cell in json.loads(notebook)["cells"])
    return "\n\n".join(text if kind == "markdown" else f"```python\n{text}\n```" for kind, text in cells)


class Diagram(SphinxDirective):
    """The diagram of the loop, which hosts of Markdown draw with a script from elsewhere: here the same as a table."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """The table of senders and readers."""
        return self.parse_text_to_nodes(messages.readers())


def _mathml(node: nodes.Element, *, as_block: bool) -> str:
    """A formula; what is marked as an accent is drawn into its letter where the system has no font for mathematics."""
    text: str = latex2mathml.tex2mathml(node.astext(), as_block=as_block)
    return text.replace(' accent="true"', "")


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_mathml(node, as_block=False))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(_mathml(node, as_block=True))
    raise nodes.SkipNode


def _generate(_app: Sphinx, _name: str, source: list[str]) -> None:
    source[0] = generated(source[0])


def _as_restructured_text(_app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Docstrings are plain text: paragraphs stay, formulas and tables of arguments keep their lines."""
    found: list[str] = []
    for paragraph in re.split(r"\n\s*\n", "\n".join(lines).strip("\n")):
        block = paragraph.splitlines()
        if all(line.startswith("  ") for line in block) or any(re.match(r"\w[\w, ]* +: ", line) for line in block):
            found += ["::", "", *(f"    {_close(line)}" for line in block), ""]
        else:
            found += [*map(_prose, block), ""]
    lines[:] = found


def _close(line: str) -> str:
    return re.sub(r"(?<=\S) {4,}", "   ", line)


def _prose(line: str) -> str:
    parts = re.split(r"(`[^`]+`)", line.strip())
    return "".join(f"`{part}`" if part.startswith("`") else re.sub(r"([*|]|_(?!\w))", r"\\\1", part) for part in parts)


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_source_suffix(".ipynb", "notebook")
    app.add_source_parser(NotebookParser)
    app.add_directive("mermaid", Diagram)
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("source-read", _generate)
    app.connect("autodoc-process-docstring", _as_restructured_text)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
