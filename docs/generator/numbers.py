"""What is kept and counted: the tables of a store, the metrics of the processes."""

from cogradar.services.metrics.processes import UP
from cogradar.services.recorder.store.tables import SCHEMA_VERSION, described
from cogradar.shared.wire.exposition import METRICS
from cogradar.shared.wire.meter import EDGES_S, FINE_EDGES_S
from docs.generator.markdown import code, prose, table


def store() -> str:
    """A part per table of a store, with a row per column, as the file itself has them."""
    parts = []
    for one, columns in described():
        rows = [(code(column.name), column.kind.lower(), column.unit, prose(column.meaning)) for column in columns]
        parts.append(
            f"### {one.name}\n\n{prose(one.meaning)}.\n\n{table(('column', 'type', 'unit', 'what it is'), rows)}"
        )
    return "\n".join(parts)


def store_version() -> str:
    """The version of the store that this program reads."""
    return f"The version is **{SCHEMA_VERSION}**.\n"


def metrics() -> str:
    """A row per metric of the page for Prometheus."""
    rows = [(code("cogradar_up"), "gauge", "", "all", prose(UP))]
    for name, meaning in METRICS.items():
        kind = meaning.kind.__name__.removesuffix("MetricFamily").lower()
        whole = f"cogradar_{name}{'_total' if kind == 'counter' else ''}"
        rows.append((code(whole), kind, meaning.label, meaning.roles, prose(meaning.text)))
    edges, fine = (", ".join(f"{edge:g}" for edge in of) for of in (EDGES_S, FINE_EDGES_S))
    text = f"\nUpper edges of the histograms: {edges} s; of dwells and margins {fine} s.\n"
    return table(("metric", "kind", "label", "from", "meaning"), rows) + text
