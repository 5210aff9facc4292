"""The diagram of the loop in the documents, as Mermaid: drawn from the table of topics, so that it cannot be wrong."""

import sys
from pathlib import Path

from cogradar.shared.protocol.topics import TOPICS, Role, Topic

BEGIN, END = "<!-- loop -->", "<!-- /loop -->"
LOOP = (Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR)  # messages between these close the loop: thick arrows


def diagram() -> str:
    """Roles as boxes, topics as arrows from sender to reader."""
    links: dict[tuple[Role, Role], list[Topic]] = {}
    for topic in TOPICS:
        for reader in topic.readers:
            links.setdefault((topic.producer, reader), []).append(topic)
    lines = ["```mermaid", "flowchart LR"]
    lines += [f"  {role}" for role in dict.fromkeys(role for link in links for role in link)]
    for (producer, reader), topics in links.items():
        arrow = "==>" if producer in LOOP and reader in LOOP else "-->"
        lines.append(f'  {producer} {arrow}|"{", ".join(map(_word, topics))}"| {reader}')
    return "\n".join([*lines, "```"])


def _word(topic: Topic) -> str:
    """What the topic is called in its key: `.../{run}/recall/scan` -> recall/scan."""
    chunks = topic.key.partition("{run}/")[2].split("/")
    return "/".join(chunk for chunk in chunks if not chunk.startswith("{"))


def rewritten(text: str) -> str:
    """A document with the diagram between its markers."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{diagram()}\n{END}{after}"


if __name__ == "__main__":
    for name in sys.argv[1:]:
        Path(name).write_text(rewritten(Path(name).read_text(encoding="utf-8")), encoding="utf-8")
