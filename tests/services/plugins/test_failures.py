"""A user's own thing that fails, or cannot be loaded: its run fails with the reason."""

from pathlib import Path

import pytest

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.runs import in_process
from cogradar.services.runs.run import strategy_of
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from tests.services.plugins.own import failing


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return 1 / 0", "bad.py, line 2: ZeroDivisionError: division by zero"),
        ("return 3", "bad.py:f returned 3: must be a Choice of a bin and a number of simulations"),
        ("return 16, 0", "bad.py:f returned bin 16: must be a whole number from 0 to 15"),
        ("return 2.0, 0", "bad.py:f returned bin 2.0: must be a whole number from 0 to 15"),
        ("return 2, -1", "bad.py:f returned n_sim -1: must be a whole number from 0 to 2147483647"),
    ],
)
def test_a_rule_that_fails_fails_its_run(folder: Path, body: str, said: str) -> None:
    scenario = load("smoke", [f"radar.planner.rule={failing(folder, 'bad.py', 'f', body)}"])
    with pytest.raises(RunFailed, match=r"planner-0: bad\.py:f") as failure:
        in_process.play(RunStart.of(scenario, strategy_of("power-aware"), 1, 4))
    assert said in str(failure.value)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise KeyError('x')", "bad.py, line 2: KeyError: 'x'"),
        ("return None", "bad.py:f returned None: must be an Emission"),
        ("return E(1.0, Z((15, 1)), Z((2, 1)), Z((2, 1)))", "a factor of shape (15, 1): must be (16, r)"),
        ("return E(1.0, Z((16, 0)), Z((3, 1)), Z((3, 1)))", "nus of shape (3, 1): must be (2, L), a row of each track"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)), Z((2, 2)))", "shares of shape (2, 2): must be (2, 1), as nus"),
        ("return E(float('nan'), Z((16, 0)), Z((2, 1)), Z((2, 1)))", "that are not finite"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)) + 0.6, Z((2, 1)))", "nus beyond -0.5 .. 0.5"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)), Z((2, 1)) - 1.0)", "an isotropic power or shares below 0"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)), Z((2, 1)), 'good')", "status 'good': must be one of fixed"),
        ("return E(1.5, Z((16, 0)), Z((2, 1)), Z((2, 1)))", "a power of 1.5: must be at most 1"),
        (
            "return E(1.0, Z((16, 0)), Z((2, 2)), Z((2, 2)))",
            "no waveform can be: the cells of a track must all be differ",
        ),
        (
            "return E(1.0, Z((16, 0)), Z((2, 1)) + float('nan'), Z((2, 1)))",
            "no waveform can be: some beams must be >= 0",
        ),
        ("return E('much', Z((16, 0)), Z((2, 1)), Z((2, 1)))", "an Emission that is none"),
    ],
)
def test_a_strategy_that_fails_fails_its_run(folder: Path, body: str, said: str) -> None:
    body = f"from numpy import zeros as Z; from cogradar.plugins import Emission as E\n    {body}"
    strategy = strategy_of(failing(folder, "bad.py", "f", body))
    with pytest.raises(RunFailed, match=r"allocator-0: bad\.py:f") as failure:
        in_process.play(RunStart.of(load("smoke"), strategy, 1, 4))
    assert said.replace("line 2", "line 3") in str(failure.value)


@pytest.mark.parametrize(
    ("method", "body", "said"),
    [
        ("begin", "return 1 / 0", "bad.py, line 8: ZeroDivisionError"),
        ("begin", "return states[0]", "bad.py:B returned float64 of shape (4,) of begin: must be (n, m) numbers"),
        ("begin", "return np.zeros((1, 200_001))", "at most 200000 numbers, 50000 on an axis"),
        ("predict", "return [[1.0], [1.0, 2.0]]", "bad.py:B returned no array of predict: "),
        ("update", "return belief, 1j", "returned evidence 1j of update: must be a finite number from 0"),
        ("predict", "return belief + float('nan')", "numbers of predict that are not finite, or beyond 1e+09"),
        ("predict", "return 2e9 * belief", "numbers of predict that are not finite, or beyond 1e+09"),
        ("update", "return belief", "returned ndarray of update: must be (belief, evidence)"),
        ("update", "return belief, -1.0", "returned evidence -1.0 of update: must be a finite number from 0"),
        ("update", "return belief, seen.likelihood(belief[:, :2]).sum()", "likelihood of states of shape"),
        ("states", "return belief[:3]", "states of shape (3, 4), x from"),
        ("states", "return -belief", "must be (n, 4), n from 5 to 50000, x from 0"),
    ],
)
def test_a_belief_that_fails_fails_its_run(folder: Path, method: str, body: str, said: str) -> None:
    head = (
        "import importlib.util as u, numpy as np\ns = u.spec_from_file_location('t', {!r})\nm = u.module_from_spec(s)\n"
    )
    arguments = {
        "begin": "radar, states, rng",
        "predict": "radar, belief, rng",
        "update": "radar, belief, seen, rng",
        "states": "radar, belief",
    }[method]
    text = f"s.loader.exec_module(m)\n\nclass B(m.Bootstrap):\n    def {method}(self, {arguments}):\n        {body}\n"
    (folder / "bad.py").write_text(head.format(f"{folder}/belief.py") + text)
    scenario = load("smoke", [f"radar.belief.filter={folder}/bad.py:B"])
    with pytest.raises(RunFailed, match=r"planner-0: bad\.py:B") as failure:
        in_process.play(RunStart.of(scenario, strategy_of("uniform"), 1, 4))
    assert said in str(failure.value)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return 1 / 0", "line 3: ZeroDivisionError"),
        ("return [0.0] * (n - 1)", "drew float64 of shape (255,): must be (256,) complex numbers, all finite"),
        ("return [float('inf')] * n", "drew float64 of shape (256,)"),
        ("return ['a'] * n", "drew <U1 of shape (256,)"),
    ],
)
def test_a_disturbance_that_fails_fails_its_run(folder: Path, body: str, said: str) -> None:
    text = (
        f"class D:\n    def draw(self, n, rng):\n        {body}\n    def power_spectrum(self, nu):\n        return nu\n"
    )
    (folder / "bad.py").write_text(text)
    scenario = load("smoke", [f"world.disturbance.model={folder}/bad.py:D"])
    with pytest.raises(RunFailed, match=r"front end: world.disturbance.model: bad.py:D") as failure:
        in_process.play(RunStart.of(scenario, strategy_of("uniform"), 1, 4))
    assert said in str(failure.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("raise OSError('no device')", "cannot be imported: {file}, line 1: OSError: no device"),
        ("f =", "cannot be imported: {file}, line 1: SyntaxError"),
        ("import sys; sys.exit(3)", "cannot be imported: {file}, line 1: SystemExit: 3"),
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("g = 1", "there is no f in {file}"),
        ("f = 1", "must be a function (problem, radar, rng, has_time) -> Choice"),
    ],
)
def test_what_cannot_be_loaded_is_said_before_a_run(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "bad.py"
    file.write_text(text)
    scenario = load("smoke", [f"radar.planner.rule={file}:f"])
    with pytest.raises(BadInput) as failure:
        in_process.play(RunStart.of(scenario, strategy_of("uniform"), 1, 4))
    assert said.format(file=file) in str(failure.value)
