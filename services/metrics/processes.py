"""What all processes count: each is asked over Zenoh. As one page for Prometheus, by role and name; as numbers."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.queries import alive, ask_expositions
from cogradar.shared.wire.session import Session

WITHIN_S = 2.0  # for the answers: less than a scraper waits, more than a process is busy with one event
UP = (
    "1 if a process answered; 0 if it shows itself alive and did not answer within two seconds,"
    " and 0 without a name if nobody plays a role."
)
Process = tuple[str, str]  # role and name
Counts = dict[tuple[str, str, str], float]  # by sample, topic, and upper edge in a histogram; "": none
NEEDED = [role for role in Role if role is not Role.OPERATOR]  # of operators those that answer are shown


@dataclass(frozen=True)
class Gathered:
    """What all processes answered; and who is alive and did not, or, without a name, is a role that nobody plays."""

    answers: dict[Process, bytes]  # text for Prometheus
    silent: set[Process]


def gather(session: Session, within_s: float = WITHIN_S) -> Gathered:
    """Ask all processes. Blocks until all have answered, at most for that long."""
    answers = ask_expositions(session, within_s)
    known: set[Process] = {
        (role, name) for role, names in alive(session, build()).names.items() if role in NEEDED for name in names
    }
    known |= {(role, "") for role in set(NEEDED) - {role for role, _ in answers.keys() | known}}
    return Gathered(answers, known - answers.keys())


def page(gathered: Gathered) -> bytes:
    """The metrics of all processes; `cogradar_up` is 0 for those that are silent."""
    registry = CollectorRegistry()
    registry.register(_Merged(gathered.answers, gathered.silent))
    return generate_latest(registry)


def counts(text: bytes) -> Counts:
    """What one process answered, as numbers."""
    families = text_string_to_metric_families(text.decode())
    return {
        (sample.name, sample.labels.get("topic", ""), sample.labels.get("le", "")): sample.value
        for family in families
        for sample in family.samples
    }


class _Merged(Collector):
    def __init__(self, answers: Mapping[Process, bytes], silent: Iterable[Process]) -> None:
        self._answers, self._silent = answers, silent

    def collect(self) -> Iterator[Metric]:
        """Each family once, with the samples of all processes."""
        up = GaugeMetricFamily("cogradar_up", UP, labels=["role", "process"])
        families: dict[str, Metric] = {}
        for (role, process), text in sorted(self._answers.items()):
            up.add_metric([role, process], 1)
            for family in text_string_to_metric_families(text.decode()):
                whole = families.setdefault(family.name, Metric(family.name, family.documentation, family.type))
                whole.samples += [
                    sample._replace(labels={"role": role, "process": process, **sample.labels})
                    for sample in family.samples
                ]
        for role, process in sorted(self._silent):
            up.add_metric([role, process], 0)
        return iter([up, *families.values()])
