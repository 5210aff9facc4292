"""Licence, notice, citation and changelog agree with pyproject.toml and with requirements.lock."""

import datetime
import re
import sys
import tomllib

import pytest
import yaml

from docs.generator import notice
from tests.docs.documents import REPOSITORY

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
CHANGELOG = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
# Keys that version 1.2.0 of the Citation File Format asks for, and of those that it knows the ones that we use.
REQUIRED = {"authors", "cff-version", "message", "title"}
KNOWN = REQUIRED | {"abstract", "date-released", "keywords", "license", "references", "type", "version"}


def test_notice_has_what_is_needed_at_run_time_as_in_the_lock() -> None:
    lock = set(re.findall(r"^([a-z0-9-]+)==(\S+)", (REPOSITORY / "requirements.lock").read_text(), re.MULTILINE))
    written = notice.FILE.read_text(encoding="utf-8")
    rows = re.findall(r"^(\S+) (\S+): (.+)$", written, re.MULTILINE)
    assert {(name, version) for name, version, _ in rows} <= lock, "make notice"
    assert notice.needed().keys() <= {name for name, _, _ in rows}, "make notice"
    assert "not stated" not in written


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="the list is for the oldest Python")
def test_notice_is_as_its_command_writes_it() -> None:
    assert notice.FILE.read_text(encoding="utf-8") == notice.text(), "make notice"


def test_one_licence_is_said_everywhere() -> None:
    assert PROJECT["license"] == CITATION["license"] == "Apache-2.0"
    assert "SPDX-License-Identifier: Apache-2.0" in (REPOSITORY / "LICENSE").read_text(encoding="utf-8")


def test_the_citation_is_complete_and_of_this_version() -> None:
    assert CITATION.keys() >= REQUIRED
    assert CITATION.keys() <= KNOWN
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["authors"] == PROJECT["authors"]
    assert CITATION["version"] == PROJECT["version"]
    (paper,) = CITATION["references"]
    assert {"authors", "title", "type"} <= paper.keys()
    assert all(author.keys() == {"family-names", "given-names"} for author in paper["authors"])


def test_the_changelog_has_dated_releases_the_newest_of_this_version() -> None:
    heads = re.findall(r"^## \[(.+)\](?: - (\S+))?$", CHANGELOG, re.MULTILINE)
    assert len(heads) == CHANGELOG.count("\n## ")
    released = [(name, datetime.date.fromisoformat(day)) for name, day in heads if name != "Unreleased"]
    assert released[0] == (CITATION["version"], CITATION["date-released"])
    assert released == sorted(released, key=lambda release: release[1], reverse=True)
    kinds = set(re.findall(r"^### (.+)$", CHANGELOG, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
