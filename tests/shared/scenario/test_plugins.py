"""Names of a user's own things: what they may be, what is behind them, and what a process may load."""

import os
import sys
from pathlib import Path

import pytest

from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.plugins import resolver, sources
from cogradar.shared.scenario.plugins.kinds import DISTURBANCE, FEED, RULE, STRATEGY
from cogradar.shared.scenario.plugins.names import PluginRefused, is_own, may_be_own, short
from cogradar.shared.scenario.plugins.resolver import load_for, resolve
from cogradar.shared.scenario.plugins.sources import allow, allowance, settled
from cogradar.shared.scenario.radar_config import Strategy

HERE = Path()
TEXT = "def rule(problem, radar, rng, has_time=None):\n    return 0, 0\n"


@pytest.fixture(autouse=True)
def _forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_allowed", sources._Allowed())
    monkeypatch.setattr(resolver, "_found", {})
    monkeypatch.setattr(resolver, "_imports", {})
    monkeypatch.delenv(sources.VARIABLE, raising=False)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed package with a rule, and an entry point of it."""
    (tmp_path / "ownrules").mkdir()
    (tmp_path / "ownrules/__init__.py").touch()
    (tmp_path / "ownrules/looks.py").write_text(TEXT)
    info = tmp_path / "ownrules-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: ownrules\nVersion: 1.0\n")
    (info / "top_level.txt").write_text("ownrules\n")
    (info / "entry_points.txt").write_text("[cogradar.rules]\nalways-first = ownrules.looks:rule\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [name for name in sys.modules if name.startswith("ownrules")]:
        monkeypatch.delitem(sys.modules, name)
    return tmp_path


def test_built_in_names_stay_as_they_are() -> None:
    for kind in (RULE, STRATEGY, DISTURBANCE):
        assert [settled(kind, name, HERE) for name in kind.built_in] == list(kind.built_in)


@pytest.mark.parametrize(
    "name",
    [
        "../ahead.py:ahead#0123456789abcdef",
        "/srv/ahead.py:ahead#0123456789abcdef",
        "ahead.py:ahead",
        "ahead.py:ahead#0123",
        "ahead.py:ahead#0123456789ABCDEF",
        "ahead.py:a-b#0123456789abcdef",
        "a b.py:f#0123456789abcdef",
        f"{120 * 'a'}.py:f#0123456789abcdef",
        "",
        "\x1b[31m.py:f#0123456789abcdef",
    ],
)
def test_a_run_has_no_other_names(name: str) -> None:
    assert not is_own(name)
    with pytest.raises(ValueError, match="is not a valid Strategy"):
        Strategy(name)


def test_a_strategy_of_somebodys_own_is_a_member_like_the_others() -> None:
    name = "ahead.py:ahead#0123456789abcdef"
    assert Strategy(name) == name
    assert Strategy(name) not in list(Strategy)
    assert short(name) == "ahead.py:ahead"
    assert may_be_own("ahead.py:ahead")
    assert not may_be_own("ahead")


def test_an_entry_point_needs_no_permission_and_a_module_does(package: Path) -> None:
    by_entry = settled(RULE, "always-first", HERE)
    assert by_entry.startswith("always-first#")
    assert resolve(RULE, by_entry).__name__ == "asked"
    digest = by_entry.partition("#")[2]
    with pytest.raises(PluginRefused, match=r"ownrules\.looks:rule: not allowed: this process loads no plug-ins"):
        resolve(RULE, f"ownrules.looks:rule#{digest}")
    assert settled(RULE, "ownrules.looks:rule", HERE) == f"ownrules.looks:rule#{digest}"
    resolve(RULE, f"ownrules.looks:rule#{digest}")
    with pytest.raises(PluginRefused, match=r"must be one of orthogonal, uniform, power-aware, or your own"):
        settled(STRATEGY, "always-first", HERE)
    with pytest.raises(PluginRefused, match=r"must be one of your own: PATH\.py:NAME"):
        settled(FEED, "always-first", HERE)  # of which none is built in
    (package / "ownrules/looks.py").write_text(TEXT + "# changed\n")
    assert settled(RULE, "ownrules.looks:rule", HERE) != f"ownrules.looks:rule#{digest}"


def test_the_version_of_a_package_is_in_the_hash(package: Path) -> None:
    before = settled(RULE, "ownrules.looks:rule", HERE)
    metadata = package / "ownrules-1.0.dist-info/METADATA"
    metadata.write_text(metadata.read_text().replace("Version: 1.0", "Version: 1.1"))
    assert settled(RULE, "ownrules.looks:rule", HERE) != before


def test_places_are_passed_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "one.py").write_text(TEXT)
    other = tmp_path / "folder"
    other.mkdir()
    (other / "two.py").write_text(TEXT)
    name = settled(RULE, "one.py:rule", tmp_path)
    monkeypatch.setenv(sources.VARIABLE, f"{other}{os.pathsep}ownrules")
    passed = allowance()
    assert passed.split(os.pathsep) == [str(tmp_path / "one.py"), str(other), "ownrules"]
    monkeypatch.delenv(sources.VARIABLE)
    monkeypatch.setattr(sources, "_allowed", sources._Allowed())
    with pytest.raises(PluginRefused, match="not here, or not allowed"):
        resolve(RULE, name)
    allow(passed)
    resolve(RULE, name)
    two = name.replace("one.py", "two.py")
    resolve(RULE, two)
    with pytest.raises(PluginRefused, match=r"two\.py:rule: .*two\.py has source .* here, the run has 0{16}"):
        resolve(RULE, f"{two.partition('#')[0]}#{16 * '0'}")


def test_of_two_files_of_one_name_the_one_of_the_run_is_taken(tmp_path: Path) -> None:
    names = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(f"{TEXT}# {folder}\n")
        names.append(settled(RULE, f"{folder}/mine.py:rule", tmp_path))
    assert names[0] != names[1]
    assert [resolve(RULE, name).__closure__ is not None for name in names] == [True, True]
    assert resolve(RULE, names[0]) is not resolve(RULE, names[1])


def test_a_file_may_be_a_link_and_a_link_opens_no_other_folder(tmp_path: Path) -> None:
    (tmp_path / "volume").mkdir()
    (tmp_path / "volume/rule.v2").write_text(TEXT)
    (tmp_path / "own").mkdir()
    (tmp_path / "own/rule.py").symlink_to("../volume/rule.v2")
    name = settled(RULE, "own/rule.py:rule", tmp_path)
    assert resolve(RULE, name).__name__ == "asked"
    sources._allowed.places.clear()
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign/link.py").symlink_to("../own/rule.py")
    (tmp_path / "foreign/mine.toml").write_text('extends = "smoke"\nradar.planner.rule = "link.py:rule"\n')
    allow(str(tmp_path / "own"))
    with pytest.raises(ScenarioError, match="a scenario file names it"):
        load(str(tmp_path / "foreign/mine.toml"))
    (tmp_path / "own/mine.toml").write_text('extends = "smoke"\nradar.planner.rule = "rule.py:rule"\n')
    assert load(str(tmp_path / "own/mine.toml")).radar.planner.rule == name


def test_a_module_that_changed_since_it_was_imported_is_refused(package: Path) -> None:
    resolve(RULE, settled(RULE, "ownrules.looks:rule", HERE))
    (package / "ownrules/looks.py").write_text(TEXT + "# changed since\n")
    with pytest.raises(PluginRefused, match="has changed since this process imported it: restart the process"):
        resolve(RULE, settled(RULE, "ownrules.looks:rule", HERE))


def test_objects_of_a_notebook_have_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(sys.modules["__main__"], "__file__", raising=False)
    made = [type("Bruit_é", (), {"__module__": "__main__", "f": code}) for code in (lambda _: 1, lambda _: 2)]
    names = [sources.bind(DISTURBANCE, one()) for one in made]
    assert [is_own(name) and name.startswith("__main__:Bruit__#") for name in names] == [True, True]
    assert names[0] != names[1]


def test_roles_load_what_is_theirs(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("raise OSError('loaded')")
    scenario = load("smoke", [f"world.disturbance.model={tmp_path}/bad.py:D"]).model_dump()
    for role in ("planner", "allocator"):
        load_for(role, scenario["radar"], "uniform", scenario["world"])
    for role in ("emulator", ""):
        with pytest.raises(PluginRefused, match="OSError: loaded"):
            load_for(role, scenario["radar"], "uniform", scenario["world"])


def test_a_scenario_of_somebody_else_runs_nothing(tmp_path: Path) -> None:
    (tmp_path / "evil.py").write_text("raise OSError('loaded')")
    file = tmp_path / "mine.toml"
    for name in (
        "evil.py:f",
        f"{tmp_path}/evil.py:f",
        "evil.py:f#0123456789abcdef",
        "json:loads",
        "nothing.py:f#0123456789abcdef",
    ):
        file.write_text(f'extends = "smoke"\nradar.planner.rule = "{name}"\n')
        with pytest.raises(ScenarioError, match=r"a scenario file names it|not allowed"):
            load(str(file))
    assert not sources._allowed.places
