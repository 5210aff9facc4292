"""What a process is to Prometheus, as text: the meaning of each of its numbers, on one page.

Names carry `cogradar_` before them, counters `_total` after them. The library's own `process_*` come on top.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import accumulate
from typing import NamedTuple

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from cogradar.shared.wire.meter import Durations, Measures, Value


class Meaning(NamedTuple):
    """What a metric is."""

    kind: type[CounterMetricFamily | GaugeMetricFamily | HistogramMetricFamily]
    text: str
    label: str = ""  # "": none
    roles: str = "all"  # the roles that have it


METRICS = {
    "messages_sent": Meaning(CounterMetricFamily, "Messages sent.", "topic"),
    "messages_received": Meaning(CounterMetricFamily, "Valid messages received.", "topic"),
    "messages_dropped": Meaning(
        CounterMetricFamily,
        "Messages dropped: bad, refused, or more than may wait; topic `other`: no key of ours.",
        "topic",
    ),
    "messages_redelivered": Meaning(
        CounterMetricFamily,
        "Messages sent again because the recorder asked for them.",
        "topic",
        "emulator, planner, allocator",
    ),
    "sent_bytes": Meaning(CounterMetricFamily, "Length of the messages sent.", "topic"),
    "received_bytes": Meaning(CounterMetricFamily, "Length of the valid messages received.", "topic"),
    "handling_seconds": Meaning(
        HistogramMetricFamily, "From taking a message, a `tick` or a `membership` to its last answer.", "topic"
    ),
    "dwell_seconds": Meaning(HistogramMetricFamily, "From one transmission of a run to the next.", roles="emulator"),
    "deadline_margin_seconds": Meaning(
        HistogramMetricFamily,
        "In real time: from a waveform's arrival to its transmission, if it was there in time.",
        roles="emulator",
    ),
    "scan_seconds": Meaning(
        HistogramMetricFamily,
        "In real time: from a transmission to its scan, which is what the front end takes.",
        roles="emulator",
    ),
    "waveforms_stale": Meaning(
        CounterMetricFamily, "In real time: dwells transmitted with an older waveform.", roles="emulator"
    ),
    "front_end_failures": Meaning(
        CounterMetricFamily, "Errors of front ends, which are then opened again.", roles="emulator"
    ),
    "front_ends_failing": Meaning(
        GaugeMetricFamily, "Runs in whose last dwell nothing was measured.", roles="emulator"
    ),
    "scans_senseless": Meaning(CounterMetricFamily, "Scans of front ends that cannot be.", roles="emulator"),
    "dwells_not_measured": Meaning(CounterMetricFamily, "Dwells in which nothing was measured.", roles="emulator"),
    "looks_asked": Meaning(CounterMetricFamily, "Looks that front ends were asked for.", roles="emulator"),
    "looks_not_measured": Meaning(CounterMetricFamily, "Looks that were asked for and not measured.", roles="emulator"),
    "plans_late": Meaning(
        CounterMetricFamily, "In real time: plans that were late, and extrapolated.", roles="allocator"
    ),
    "tracks_ended": Meaning(
        CounterMetricFamily,
        "Confirmed tracks that ended, where the number of targets is unknown: they flew away or were lost.",
        roles="allocator",
    ),
    "tracks_owned": Meaning(GaugeMetricFamily, "Tracks that a planner owns, over all runs.", roles="planner"),
    "shards_held": Meaning(
        GaugeMetricFamily, "Of 16 shards of the runs, those that this process serves.", roles="emulator, allocator"
    ),
    "dwells": Meaning(CounterMetricFamily, "Dwells that are durable in the journal.", roles="recorder"),
    "commit_seconds": Meaning(HistogramMetricFamily, "To make the journal's newest rows durable.", roles="recorder"),
    "certificate_days": Meaning(
        GaugeMetricFamily, "Days until the certificate of a process ends, negative if it has; without one: nothing."
    ),
    "journal_full": Meaning(
        GaugeMetricFamily, "1 while the journal cannot be written and runs are held.", roles="recorder"
    ),
    "journal_bytes": Meaning(GaugeMetricFamily, "Length of the journal and of its write-ahead log.", roles="metrics"),
    "snapshot_bytes": Meaning(GaugeMetricFamily, "Length of the snapshots of tracks in the journal.", roles="metrics"),
    "runs": Meaning(GaugeMetricFamily, "Runs in the journal.", "status", "metrics"),
    "dwell_age_seconds": Meaning(
        GaugeMetricFamily, "Since a run that goes on had its newest durable dwell, the longest.", roles="metrics"
    ),
    "tracks": Meaning(
        GaugeMetricFamily,
        "Confirmed tracks in the newest dwells of all runs that go on; so is all that follows.",
        roles="metrics",
    ),
    "targets": Meaning(GaugeMetricFamily, "Targets that count, NaN without truth.", roles="metrics"),
    "targets_missed": Meaning(GaugeMetricFamily, "... of them without a track within 5 km.", roles="metrics"),
    "tracks_false": Meaning(
        GaugeMetricFamily, "Tracks without a target within 5 km, NaN without truth.", roles="metrics"
    ),
    "tracks_lost": Meaning(
        GaugeMetricFamily, "Targets whose track has been out of their bin for the last 20 dwells.", roles="metrics"
    ),
    "detected_share": Meaning(GaugeMetricFamily, "Share of the targets there that were detected.", roles="metrics"),
    "gospa_km": Meaning(GaugeMetricFamily, "GOSPA, p 2, c 5 km, mean over runs, NaN without truth.", roles="metrics"),
    "blind_share": Meaning(GaugeMetricFamily, "Share of the cells tested that were blind.", roles="metrics"),
    "query_seconds": Meaning(
        HistogramMetricFamily, "To answer a query over Zenoh: `answered`, `refused`, `failed`.", "status", "metrics"
    ),
}


class Exposition(Collector):
    """A process's metrics."""

    def __init__(self, measures: Callable[[], Measures]) -> None:
        """`measures` are asked for at every scrape."""
        self._measures = measures
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._registry.register(self)

    def collect(self) -> Iterator[Metric]:
        """The families of all measures."""
        for name, measured in self._measures().items():
            yield _family(name, measured)

    def text(self) -> bytes:
        """The process as Prometheus reads it."""
        return generate_latest(self._registry)


def _family(name: str, measured: Value | Mapping[str, Value]) -> Metric:
    """A metric with its values, by label or alone."""
    meaning = METRICS[name]
    labels = [meaning.label] if meaning.label else []
    family = meaning.kind(f"cogradar_{name}", meaning.text, labels=labels)
    for label, value in measured.items() if isinstance(measured, Mapping) else [("", measured)]:
        at = [label] if meaning.label else []
        match family, value:
            case HistogramMetricFamily(), Durations():
                edges = [*map(str, value.edges_s), "+Inf"]
                family.add_metric(at, list(zip(edges, accumulate(value.counts), strict=True)), value.sum_s)
            case ((CounterMetricFamily() | GaugeMetricFamily()), int() | float()):
                family.add_metric(at, value)
            case _:
                raise TypeError(f"{name} = {value!r}: not a {family.type}")
    return family
