"""Compiled kernels: where they are kept, that they equal their sources, that a stop is noticed."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from cogradar.shared.numerics import jit
from cogradar.shared.numerics.jit import CACHE_DIR, NOT_KEPT, compiling, kernel, late_kernels
from cogradar.shared.signal.angle import bin_of
from tests.plain import plain

REPOSITORY = Path(__file__).resolve().parents[3]


def test_tests_compile_into_a_folder_of_their_own() -> None:
    assert CACHE_DIR.is_relative_to(REPOSITORY / "build")
    user = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    assert not CACHE_DIR.is_relative_to(Path(user) / "cogradar")
    assert Path(numba.config.CACHE_DIR) == CACHE_DIR
    assert NOT_KEPT == ""
    bin_of(1.0, 2.0, 5)
    assert list(CACHE_DIR.glob("*/angle.bin_of-*.nbi"))


def test_a_process_started_by_a_test_shares_that_folder() -> None:
    command = [sys.executable, "-c", "from cogradar.shared.numerics.jit import CACHE_DIR; print(CACHE_DIR)"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == str(CACHE_DIR)


def test_a_change_of_what_kernels_depend_on_is_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "_SOURCES", tmp_path)
    room = tmp_path / "signal" / "inner"
    room.mkdir(parents=True)
    (room / "a.py").write_text(
        "from cogradar.shared.numerics.jit import kernel\nfrom cogradar.shared.signal import (\n    b,\n)\n"
    )
    (tmp_path / "signal" / "b.py").write_text("def f() -> None:\n    import cogradar.shared.c\n")
    (tmp_path / "c.py").write_text("x = 1")
    (tmp_path / "messages.py").write_text("x = 1")
    folders = [jit.cache_dir()]
    (tmp_path / "messages.py").write_text("x = 2")
    (tmp_path / "notes.txt").write_text("no source")
    assert jit.cache_dir() == folders[0]
    (tmp_path / "c.py").write_text("x = 2")
    folders.append(jit.cache_dir())
    (tmp_path / "signal" / "b.py").write_text("x = 1")
    folders.append(jit.cache_dir())
    (room / "a.py").rename(tmp_path / "signal" / "a.py")
    folders.append(jit.cache_dir())
    assert len(set(folders)) == 4


def test_nothing_that_a_module_with_kernels_imports_is_left_out() -> None:
    """As Python itself sees it: all modules of `shared` that are there once the kernels' are imported."""
    script = (
        "import sys, importlib\n"
        "from pathlib import Path\n"
        "from cogradar.shared.numerics import jit\n"
        "root = jit._SOURCES\n"
        "for source in jit.kernel_sources():\n"
        "    importlib.import_module('.'.join(('cogradar.shared', *source.relative_to(root).with_suffix('').parts)))\n"
        "here = [m.__file__ for n, m in sys.modules.items() if n.startswith('cogradar.shared.')]\n"
        "files = {Path(file).resolve() for file in here if file and '__init__' not in file}\n"
        "print(*sorted(files - set(jit.kernel_sources())))"
    )
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "\n"


@pytest.mark.parametrize("folder", ["/proc/x", "/dev/null/x"])
def test_a_folder_in_which_nothing_can_be_kept_says_why(folder: str) -> None:
    assert jit._refusal(Path(folder)) in {"No such file or directory", "Not a directory"}


def test_a_user_without_a_home_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.delenv("COGRADAR_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert jit._refusal(jit.cache_dir()) == "Not a directory"


@pytest.mark.parametrize("temporary", [True, False])
def test_kernels_work_where_nothing_can_be_kept(temporary: bool, tmp_path: Path) -> None:
    """In a folder that goes with the command, or, with no room for that either, without any."""
    script = (
        "import os, sys, tempfile\n"
        "if len(sys.argv) > 2: tempfile.tempdir = '/dev/null'\n"
        "from cogradar.shared.signal.angle import bin_of\n"
        "from cogradar.shared.numerics.jit import CACHED, CACHE_DIR, NOT_KEPT\n"
        "assert bin_of(1.0, 2.0, 9) == bin_of.py_func(1.0, 2.0, 9)\n"
        "print(NOT_KEPT, CACHED, str(CACHE_DIR).startswith(sys.argv[1]), os.environ['COGRADAR_CACHE_DIR'], sep=';')"
    )
    command = [sys.executable, "-c", script, str(tmp_path)] + ([] if temporary else ["no"])
    environment = os.environ | {"COGRADAR_CACHE_DIR": "/proc/x", "TMPDIR": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    reason, cached, inside, handed_on = done.stdout.strip().split(";")
    assert reason.startswith("/proc/x/cogradar/kernels-")
    assert reason.endswith(": No such file or directory")
    assert (cached, inside, done.stderr) == (str(temporary), str(temporary), "")
    assert (Path(handed_on).parent == tmp_path) == temporary  # to the processes that are started
    assert list(tmp_path.iterdir()) == []


_PROBLEM = """
from typing import NamedTuple
from cogradar.shared.planning.problem import implement

class Constant(NamedTuple):
    scale: float

def mean_rollout(problem, n_level, gamma):
    return {worth} * problem.scale

implement(Constant, mean_rollout)
"""
_VALUE = """
import constant
from cogradar.shared.planning.pomcp import SearchSettings, _leaf_values
settings = SearchSettings(n_sim=1, depth=1, rollout_depth=1, rollout_mean=True, gamma=0.5, ucb_c=1.0)
print(_leaf_values(constant.Constant(2.0), settings)[1], sum(_leaf_values.stats.cache_hits.values()))
"""


def test_a_changed_problem_outside_shared_is_compiled_anew(tmp_path: Path) -> None:
    """And an unchanged one is found; what programs without it read does not name it."""
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{REPOSITORY}", "COGRADAR_CACHE_DIR": str(tmp_path)}
    outcomes = []
    for worth in (1.0, 1.0, 3.0):
        (tmp_path / "constant.py").write_text(_PROBLEM.format(worth=worth))
        command = [sys.executable, "-B", "-c", _VALUE]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        outcomes.append(done.stdout.split())
    assert outcomes == [["2.0", "0"], ["2.0", "1"], ["6.0", "0"]]
    indices = [path.name for path in tmp_path.rglob("pomcp._leaf_values-*.nbi")]
    assert len(indices) == 2
    assert len({name.rsplit("-", 1)[1] for name in indices}) == 2


@kernel
def _walk(n: int, rng: np.random.Generator) -> float:
    total = 0.0
    for _ in range(n):
        total += rng.standard_normal() * rng.random()
    return total


def test_a_generator_gives_a_kernel_the_stream_that_it_gives_numpy() -> None:
    draws = [function(1000, np.random.default_rng(3)) for function in (_walk, plain(_walk))]
    rng = np.random.default_rng(3)
    expected = 0.0
    for _ in range(1000):
        expected += rng.standard_normal() * rng.random()
    assert draws == [expected, expected]


def test_compiling_can_be_stopped_by_what_the_check_raises() -> None:
    class Stopped(Exception):
        pass

    inner = numba.njit(lambda x: x + 1.0)
    outer = numba.njit(lambda x: 2.0 * inner(x))
    begun, late = list[int](), list[tuple[str, float]]()

    def check() -> None:
        begun.append(1)
        if len(begun) == 2:  # while the one is compiled for the other
            raise Stopped

    with compiling(check), pytest.raises(Stopped):
        outer(1.0)
    assert len(begun) == 2
    with late_kernels(lambda *kernel: late.append(kernel)):
        assert outer(1.0) == 4.0  # nothing is left half done, and nobody is asked any more
        assert outer(2.0) == 6.0
    ((name, took_s),) = late  # with the one that it calls
    assert name.endswith("<lambda>")
    assert 0.0 < took_s < 60.0
    assert len(begun) == 2
