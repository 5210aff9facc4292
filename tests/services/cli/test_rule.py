"""`--rule`: short for a setting, on the commands that play runs."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.shared.scenario.tables import RULES
from tests.services.stored import rows

RUN = ["run", "smoke", "--in-process", "--json", "--dwells", "3"]


def test_it_is_the_setting_of_that_name() -> None:
    digests = []
    for chosen in (["--rule", "mode"], ["--set", "radar.planner.rule=mode"], ["--rule", "exact"]):
        done = CliRunner().invoke(app, [*RUN, *chosen])
        assert done.exit_code == 0, done.output
        digests.append(json.loads(done.stdout)["digest"])
    assert digests[0] == digests[1]


def test_a_campaign_plays_it(tmp_path: Path) -> None:
    store = str(tmp_path / "c.db")
    small = ["--runs", "1", "--dwells", "2", "--strategies", "uniform", "--workers", "1"]
    done = CliRunner().invoke(app, ["campaign", "smoke", "--store", store, "--rule", "oracle", *small])
    assert done.exit_code == 0, done.output
    (row,) = rows(store, "SELECT document FROM run")
    document = json.loads(row["document"])
    assert document["radar"]["planner"]["rule"] == "oracle"
    assert document["title"].endswith("(knows the truth)")


@pytest.mark.parametrize("command", [RUN, ["campaign", "smoke", "--store", "c.db"]])
def test_an_unknown_one_is_named_beside_those_there_are(command: list[str]) -> None:
    done = CliRunner().invoke(app, [*command, "--rule", "luck"])
    assert done.exit_code == 2
    words = " ".join(done.output.replace("│", " ").split())
    assert f"--rule luck: must be one of {', '.join(RULES)}, or your own: PATH.py:NAME" in words
