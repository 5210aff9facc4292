"""What all processes count: each is asked over Zenoh. As one page for Prometheus, by role and name; as numbers.

An answer is another participant's word: it is bounded, and only metrics, labels and values that we know are taken.
What cannot be read is dropped and counted, and all others are shown.
"""

import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector
from prometheus_client.samples import Sample

from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.fields import PROCESS_NAME
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.faults import printable
from cogradar.shared.wire.exposition import METRICS, Exposition
from cogradar.shared.wire.queries import alive, ask_expositions
from cogradar.shared.wire.session import Session

WITHIN_S = 2.0  # for the answers: less than a scraper waits, more than a process is busy with one event
MAX_BYTES, MAX_LINES = 256 << 10, 5000  # of an answer; a busy process has some 30 KiB, 400 lines
MAX_PROCESSES = 1000  # whose answers are shown
DROPPED = "Answers of a process to this scrape that were dropped: too long, no metrics, or of no process of ours."
UP = (
    "1 if a process answered; 0 if it shows itself alive and did not answer within two seconds,"
    " and 0 without a name if a role has no process."
)
Process = tuple[str, str]  # role and name
Counts = dict[tuple[str, str, str], float]  # by sample, topic, and upper edge in a histogram; "": none
log = logging.getLogger(__name__)
NEEDED = [role for role in Role if role is not Role.OPERATOR]  # of operators those that answer are shown


@dataclass(frozen=True)
class Gathered:
    """What all processes answered, which ones are alive and did not, and, without a name, roles without a process."""

    answers: dict[Process, list[Metric]]
    silent: set[Process]
    dropped: dict[Process, str] = field(default_factory=dict)  # of which the answer was dropped, and why


def gather(session: Session, within_s: float = WITHIN_S) -> Gathered:
    """Ask all processes. Blocks until all have answered, at most for that long."""
    answers, dropped = _read(ask_expositions(session, within_s, MAX_BYTES))
    known: set[Process] = {
        (role, name) for role, names in alive(session, build()).names.items() if role in NEEDED for name in names
    }
    known |= {(role, "") for role in set(NEEDED) - {role for role, _ in answers.keys() | known}}
    return Gathered(answers, known - answers.keys(), dropped)


def page(gathered: Gathered) -> bytes:
    """The metrics of all processes; `cogradar_up` is 0 for those that are silent."""
    registry = CollectorRegistry()
    registry.register(_Merged(gathered))
    return generate_latest(registry)


def _read(found: Iterable[tuple[Process, bytes]]) -> tuple[dict[Process, list[Metric]], dict[Process, str]]:
    """What answers say, and why those that say nothing are dropped; of several of one process the first counts."""
    answers: dict[Process, list[Metric]] = {}
    dropped: dict[Process, str] = {}
    for (role, name), text in found:
        if role not in set(Role) or not re.fullmatch(PROCESS_NAME, name):
            dropped["", ""] = f"{printable(f'{role}/{name}')[:80]}: no process of ours"
        elif len(answers) >= MAX_PROCESSES:
            dropped["", ""] = f"more than {MAX_PROCESSES} processes"
        elif (role, name) not in answers:
            try:
                answers[role, name] = read(text)
            except ValueError as error:
                dropped[role, name] = printable(f"{role} {name}: {error}")[:200]
    for reason in dropped.values():
        log.warning("metrics dropped: %s", reason)
    return answers, {process: reason for process, reason in dropped.items() if process not in answers}


def read(text: bytes) -> list[Metric]:
    """What one process answered: metrics that we know, with the labels that they have. Raises ValueError."""
    if len(text) > MAX_BYTES or text.count(b"\n") > MAX_LINES:
        raise ValueError(f"{len(text)} bytes, {text.count(chr(10).encode())} lines: too long")
    known, found = _known(), list[Metric]()
    try:
        families = list(text_string_to_metric_families(text.decode()))
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"not what Prometheus reads: {error}") from None
    for family in families:
        if (own := known.get(family.name)) is None or own.type != family.type:
            continue
        metric, label = Metric(own.name, own.documentation, own.type), _label_of(own.name)
        samples: dict[object, Sample] = {}  # a label that is not ours could make two of one
        for sample in family.samples:
            labels = {name: value for name, value in sample.labels.items() if name in {label, "le"}}
            if sample.name.endswith("_bucket") and not _is_edge(labels.get("le", "")):
                continue
            samples.setdefault((sample.name, *sorted(labels.items())), sample._replace(labels=labels, exemplar=None))
        metric.samples = [sample._replace(timestamp=None) for sample in samples.values()]
        found.append(metric)
    return found


def _is_edge(text: str) -> bool:
    """Whether this is an upper edge of a histogram's bucket: a time."""
    try:
        return float(text) > 0.0
    except ValueError:
        return False


def _label_of(family: str) -> str:
    meaning = METRICS.get(family.removeprefix("cogradar_"))
    return meaning.label if meaning is not None else ""


@cache
def _known() -> dict[str, Metric]:
    """All metrics that a process can have."""
    of_library = {family.name: family for family in text_string_to_metric_families(Exposition(dict).text().decode())}
    families = [meaning.kind(f"cogradar_{name}", meaning.text) for name, meaning in METRICS.items()]
    return of_library | {family.name: family for family in families}


def counts(families: Sequence[Metric]) -> Counts:
    """What one process answered, as numbers."""
    return {
        (sample.name, sample.labels.get("topic", ""), sample.labels.get("le", "")): sample.value
        for family in families
        for sample in family.samples
    }


class _Merged(Collector):
    def __init__(self, gathered: Gathered) -> None:
        self._gathered = gathered

    def collect(self) -> Iterator[Metric]:
        """Each family once, with the samples of all processes."""
        up = GaugeMetricFamily("cogradar_up", UP, labels=["role", "process"])
        families: dict[str, Metric] = {}
        dropped = GaugeMetricFamily("cogradar_answers_dropped", DROPPED, labels=["role", "process"])
        answers: Mapping[Process, Sequence[Metric]] = self._gathered.answers
        for role, process in sorted(self._gathered.dropped):
            dropped.add_metric([role, process], 1)
        for role, process in sorted(answers):
            up.add_metric([role, process], 1)
            for family in answers[role, process]:
                whole = families.setdefault(family.name, Metric(family.name, family.documentation, family.type))
                whole.samples += [
                    sample._replace(labels={**sample.labels, "role": role, "process": process})
                    for sample in family.samples
                ]
        for role, process in sorted(self._gathered.silent):
            up.add_metric([role, process], 0)
        return iter([up, dropped, *families.values()])
