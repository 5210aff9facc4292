"""What one process answers cannot spoil what is shown of the others."""

import re

import pytest
from prometheus_client.parser import text_string_to_metric_families

from cogradar.services.metrics.processes import MAX_BYTES, Gathered, _read, counts, page, read
from cogradar.services.web.views.processes import quantile
from cogradar.shared.wire.exposition import Exposition

GOOD = Exposition(lambda: {"messages_sent": {"scan": 3}, "journal_full": 0}).text()
ME, OTHER = ("planner", "planner-1"), ("recorder", "recorder")
BAD = {
    "bytes": b"\xff",
    "text": b"no metrics {",
    "long": b"# " + bytes(MAX_BYTES),
    "many series": b"".join(b'cogradar_messages_sent_total{topic="%d"} 1\n' % i for i in range(6000)),
    "value": b"cogradar_journal_full x\n",
    "label": b'cogradar_messages_sent_total{topic="\xff"} 1\n',
}


def _page(*found: tuple[tuple[str, str], bytes]) -> tuple[str, Gathered]:
    answers, dropped = _read(found)
    gathered = Gathered(answers, {process for process, _ in found if process in dropped}, dropped)
    text = page(gathered).decode()
    list(text_string_to_metric_families(text))
    return text, gathered


@pytest.mark.parametrize("what", BAD)
def test_a_bad_answer_is_dropped_and_counted_and_the_others_are_shown(what: str) -> None:
    text, gathered = _page((ME, BAD[what]), (OTHER, GOOD))
    assert 'cogradar_up{process="recorder",role="recorder"} 1.0' in text
    assert 'cogradar_up{process="planner-1",role="planner"} 0.0' in text
    assert 'cogradar_answers_dropped{process="planner-1",role="planner"} 1.0' in text
    assert 'cogradar_messages_sent_total{process="recorder",role="recorder",topic="scan"} 3.0' in text
    assert counts(gathered.answers[OTHER])["cogradar_messages_sent_total", "scan", ""] == 3.0


def test_nobody_speaks_for_another_process() -> None:
    forged = b"""# TYPE cogradar_journal_full gauge
cogradar_journal_full{role="recorder",process="recorder"} 1
# TYPE cogradar_messages_sent_total counter
cogradar_messages_sent_total{topic="scan",process="recorder",more="x"} 5
cogradar_messages_sent_total{topic="scan",process="emulator"} 7
# TYPE cogradar_up gauge
cogradar_up{role="allocator",process="allocator"} 1
# TYPE node_load1 gauge
node_load1 3
"""
    text, _ = _page((ME, forged), (OTHER, GOOD))
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert [line for line in lines if line.startswith("cogradar_journal_full")] == [
        'cogradar_journal_full{process="planner-1",role="planner"} 1.0',
        'cogradar_journal_full{process="recorder",role="recorder"} 0.0',
    ]
    assert 'cogradar_messages_sent_total{process="planner-1",role="planner",topic="scan"} 5.0' in lines
    assert not re.search("more|emulator|allocator|node_load1", "".join(lines))


def test_a_type_of_ours_is_not_changed() -> None:
    text, _ = _page((ME, b"# TYPE cogradar_journal_full counter\ncogradar_journal_full_total 1\n"), (OTHER, GOOD))
    assert "# TYPE cogradar_journal_full gauge" in text


def test_buckets_without_an_edge_are_left_out() -> None:
    """A percentile of them would fail, and with it the page of all processes."""
    edges = ("x", "", "nan", "-2", "0", "1e-400", "0.5", "+Inf")
    name = "cogradar_dwell_seconds"
    lines = [f"# TYPE {name} histogram", *(f'{name}_bucket{{le="{edge}"}} 3' for edge in edges), f"{name}_bucket 3"]
    found = counts(read("\n".join(lines).encode()))
    assert {edge for _, _, edge in found} == {"0.5", "+Inf"}
    assert quantile([(float(edge), n) for (_, _, edge), n in sorted(found.items(), reverse=True)], 0.5) is not None


def test_answers_on_keys_of_no_process_are_left_out() -> None:
    answers, dropped = _read([(("king", "x"), GOOD), (("planner", "a\x1b[2J"), GOOD), (OTHER, GOOD), (OTHER, b"\xff")])
    assert answers.keys() == {OTHER}
    assert dropped.keys() == {("", "")}
    assert "\x1b" not in dropped["", ""]


def test_an_answer_of_ours_is_taken_as_it_is() -> None:
    shown = {(sample.name, sample.value) for family in read(GOOD) for sample in family.samples}
    text = list(text_string_to_metric_families(GOOD.decode()))
    assert shown == {(sample.name, sample.value) for family in text for sample in family.samples}
