"""All processes as one page for Prometheus: each is asked over Zenoh, and labelled with its role and name."""

from collections.abc import Iterable, Iterator, Mapping

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from shared.protocol.topics import Role
from shared.wire.queries import alive, ask_expositions
from shared.wire.session import Session

WITHIN_S = 2.0  # for the answers: less than a scraper waits, more than a process is busy with one event
UP = (
    "1 if a process answered; 0 if it shows itself alive and did not answer within two seconds,"
    " and 0 without a name if nobody plays a role."
)
NEEDED = [role for role in Role if role is not Role.OPERATOR]  # of operators those that answer are shown


def page(session: Session, within_s: float = WITHIN_S) -> bytes:
    """The metrics of all processes. Blocks until all have answered, at most for that long.

    `cogradar_up` is 0 for a process that shows itself alive and does not answer; and, without a name, for a role that
    nobody plays.
    """
    answers = ask_expositions(session, within_s)
    known = {(role, name) for role, names in alive(session).items() if role in NEEDED for name in names}
    known |= {(role, "") for role in set(NEEDED) - {role for role, _ in answers.keys() | known}}
    registry = CollectorRegistry()
    registry.register(_Merged(answers, known - answers.keys()))
    return generate_latest(registry)


class _Merged(Collector):
    def __init__(self, answers: Mapping[tuple[str, str], bytes], silent: Iterable[tuple[str, str]]) -> None:
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
