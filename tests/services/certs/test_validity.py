"""A certificate that is about to end is said in the log once a day, and its days are in the metrics."""

import logging
from pathlib import Path

import pytest

from cogradar.services.certs import authority
from cogradar.services.certs.validity import DAY_S, Validity
from cogradar.shared.wire.session import CONFIG_VARIABLE


@pytest.mark.parametrize(("days", "lines"), [(40, 0), (20, 3)])
def test_it_is_said_at_the_start_and_each_day(
    days: int, lines: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    authority.create(tmp_path / "certs", 50)
    (file,) = authority.issue(tmp_path / "certs", ["planner.a"], [], days)
    monkeypatch.setenv(CONFIG_VARIABLE, str(file))
    validity = Validity.at("tls/127.0.0.1:1")
    assert validity.measures() == {"certificate_days": pytest.approx(days, abs=0.01)}
    began_s, after_s = validity._now_s(), 0.0
    validity._now_s = lambda: began_s + after_s
    with caplog.at_level(logging.WARNING):
        while after_s < 2.5 * DAY_S:
            validity.tell()
            after_s += 0.1 * DAY_S
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == lines
    assert not lines or said[1].startswith(f"the certificate of planner.a ends in {days - 1}.0 days: issue another one")


def test_one_that_has_ended_is_said_too(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    authority.create(tmp_path / "certs", 50)
    end_s = (tmp_path / "certs/ca.crt").read_bytes()
    Validity(end_s, lambda: authority.end_of(end_s) + 2 * DAY_S).tell()
    (record,) = caplog.records
    assert "the certificate of cogradar ended 2.0 days ago" in record.getMessage()


def test_without_a_certificate_nothing_is_said(caplog: pytest.LogCaptureFixture) -> None:
    validity = Validity.at("tcp/127.0.0.1:1")
    validity.tell()
    assert (validity.measures(), caplog.records) == ({}, [])
