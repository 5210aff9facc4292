"""An installed wheel is the whole program: built, installed into a fresh environment, used from an empty folder."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from importlib import import_module
from pathlib import Path

import pytest

import cogradar

ROOT = Path(__file__).parents[2]
SOURCES = ("cogradar", "services", "shared", "deploy/scenarios", "deploy/plugins", "studies")  # the last is not in it


def _call(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "COGRADAR"))}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=True, timeout=60)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy of the sources: nothing that an earlier build left is in it."""
    copy, built = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, copy)
    offline = ("--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check")
    _call(sys.executable, "-m", "pip", "wheel", "--quiet", *offline, "--wheel-dir", built, copy, cwd=built)
    (found,) = built.iterdir()
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scripts of an environment with this wheel, and the libraries that are installed here."""
    folder = tmp_path_factory.mktemp("environment")
    _call(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = (sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "--quiet")
    _call(*pip, "--no-deps", "--no-index", "--disable-pip-version-check", wheel, cwd=folder)
    return folder / "bin"


def test_the_wheel_has_every_source_and_every_scenario(wheel: Path) -> None:
    files = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    sources = {f"cogradar/{path.relative_to(ROOT)}" for top in SOURCES[1:3] for path in (ROOT / top).rglob("*.py")}
    sources |= {str(path.relative_to(ROOT)) for path in (ROOT / "cogradar").glob("*.py")}
    scenarios = {f"cogradar/scenarios/{path.name}" for path in (ROOT / "deploy/scenarios").glob("*.toml")}
    templates = {f"cogradar/templates/{path.name}" for path in (ROOT / "deploy/plugins").glob("*.py")}
    page = {f"cogradar/{path.relative_to(ROOT)}" for path in (ROOT / "services/web/page").iterdir()}
    data = {f"cogradar/services/bench/{name}" for name in ("figures.toml", "golden_digests.json")} | {
        "cogradar/py.typed"
    }
    assert files == sources | scenarios | templates | page | data


def test_the_command_line_of_a_wheel_works_from_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    listed = _call(installed / "cogradar", "scenarios", cwd=tmp_path).stdout
    assert {"paper", "paper-literal", "smoke"} <= {line.split()[0] for line in listed.splitlines()}
    assert "valid" in _call(installed / "python", "-m", "cogradar", "check", "paper", cwd=tmp_path).stdout
    assert list(tmp_path.iterdir()) == []


def test_the_public_face_of_a_wheel_is_the_installed_one(installed: Path, tmp_path: Path) -> None:
    program = "import cogradar; print(cogradar.load('paper').name, cogradar.__file__)"
    name, file = _call(installed / "python", "-c", program, cwd=tmp_path).stdout.split()
    assert name == "paper"
    assert Path(file).is_relative_to(installed.parent)


@pytest.mark.parametrize("name", ["services", "shared"])
def test_a_folder_of_the_sources_is_no_package_of_its_own(name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"import {name}"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert f"in Python, this folder is cogradar.{name}" in done.stderr


@pytest.mark.parametrize("name", sorted({*cogradar.__all__, *cogradar._OTHERS}))
def test_a_public_name_is_found_when_it_is_asked_for(name: str) -> None:
    assert getattr(cogradar, name) is getattr(import_module("cogradar.api"), name)
    assert name in dir(cogradar)


def test_the_package_alone_loads_no_library() -> None:
    program = "import sys, cogradar; print(*sorted({'numpy', 'pydantic', 'numba', 'zenoh'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
