"""What `cogradar check FILE.py` finds, and the files of `cogradar new`."""

import re
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput
from cogradar.services.front_ends import open_front_end
from cogradar.services.metrics.store import Store
from cogradar.services.plugins import kit, templates, trials
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from tests.services.loop import smoke_start


@pytest.mark.parametrize("kind", templates.kinds())
def test_each_file_to_begin_with_is_as_it_should_be(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    assert "mine.py" in templates.write(kind, file)
    found = kit.check(str(file), kind)
    assert [one for one in found if not one.ok] == []
    assert len({one.name for one in found}) == 1
    assert f"as {kind} mine.py:" in found[0].found
    repeated = set() if kind == "front-end" else {"determinism"}
    kept = {"snapshot"} if kind == "belief" else set() if kind in {"rule", "strategy", "objective"} else {"arguments"}
    assert {one.check for one in found} >= {"answers", *repeated, *kept, "random numbers", "cost"}
    told = {one.found.split()[1] for one in kit.check(str(file)) if one.check == "loads"}
    assert told == {"strategy" if kind == "objective" else kind}  # which look alike


def test_a_front_end_that_cannot_be_is_found(tmp_path: Path) -> None:
    templates.write("front-end", tmp_path / "mine.py")
    text = (tmp_path / "mine.py").read_text()
    (tmp_path / "mine.py").write_text(text.replace("default_rng(7)", "default_rng(7 // 0)"))
    answers = [one for one in kit.check(f"{tmp_path}/mine.py:Receiver") if one.check == "answers"]
    assert ["ZeroDivisionError" in one.found and not one.ok for one in answers] == [True]


def test_a_front_end_that_hangs_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trials, "FIRST_S", 0.1)
    templates.write("front-end", tmp_path / "mine.py")
    text = (tmp_path / "mine.py").read_text()
    (tmp_path / "mine.py").write_text(
        text.replace("        w = root", "        __import__('time').sleep(1.0)\n        w = root")
    )
    (answer,) = [one for one in kit.check(f"{tmp_path}/mine.py:Receiver") if one.check == "answers"]
    assert (answer.ok, "transmit did not return within 0.1 s" in answer.found) == (False, True)


@pytest.mark.parametrize(
    ("line", "said", "is_ok"),
    [
        (
            "pass",
            r"^20 of acquisition and beams; the first in \S+ ms, the slowest, dwell \d+, in \S+ ms",
            True,
        ),
        ("assert k < 7", r"^dwell 7: mine\.py, line \d+: AssertionError", False),
        ("assert waveform.isotropic", r"^dwell 5: mine\.py, line \d+: AssertionError", False),  # no beams
        ("if k == 9: return None", r"^9 of acquisition and beams; then there are no more; the first", True),
        ("return None", "^none: transmit returned None at the first one, which ends a run$", False),
        (
            "return ScanData.not_measured('no packet')",
            r"^20 of .*; nothing was measured in 20 of them, no packet; with power everywhere and beams nothing is",
            False,
        ),
        (
            "if not waveform.isotropic: return ScanData.not_measured()",
            r"nothing was measured in 15 of them; with beams nothing is ever measured: a run would find or keep no",
            False,
        ),
        (
            "if k == 3: return ScanData.not_measured('no packet')",
            r"^20 of acquisition and beams; nothing was measured in 1 of them, no packet; the first",
            True,
        ),
        ("__import__('time').sleep(1.1 * (k == 6))", r"the slowest, dwell 6, in 1\S+ ms of 1000 ms$", False),
    ],
)
def test_several_dwells_of_a_front_end_are_tried(line: str, said: str, is_ok: bool, tmp_path: Path) -> None:
    templates.write("front-end", tmp_path / "mine.py")
    text = (tmp_path / "mine.py").read_text()
    (tmp_path / "mine.py").write_text(text.replace("        w = root", f"        {line}\n        w = root"))
    found = [one for one in kit.check(f"{tmp_path}/mine.py:Receiver") if one.check in {"dwells", "answers"}]
    assert found[0].ok  # one dwell of an acquisition
    assert (found[-1].ok, bool(re.search(said, found[-1].found))) == (is_ok, True), found[-1].found


HEAD = "import random\nimport numpy as np\nfrom cogradar.plugins import Choice\n\ncalls = []\n\n\n"


@pytest.mark.parametrize(
    ("body", "check", "said"),
    [
        ("return Choice(99, 0)", "answers", "mine.py:f returned bin 99: must be a whole number from 0 to 15"),
        ("return 1 / 0", "answers", "line 9: ZeroDivisionError"),
        ("calls.append(1); return Choice(len(calls) % 16, 0)", "determinism", "another answer when asked again"),
        ("return Choice(random.randrange(16), 0)", "random numbers", "draws from Python's or NumPy's global generator"),
        ("return Choice(np.random.randint(16), 0)", "random numbers", "draws from Python's or NumPy's"),
    ],
)
def test_what_is_wrong_with_a_rule_is_found(body: str, check: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(f"{HEAD}def f(problem, radar, rng, has_time=None):\n    {body}\n")
    found = {one.check: one for one in kit.check(str(tmp_path / "mine.py"))}
    assert not found[check].ok
    assert said in found[check].found


def test_a_belief_that_remembers_more_than_its_numbers_is_found(tmp_path: Path) -> None:
    templates.write("belief", tmp_path / "mine.py")
    text = (tmp_path / "mine.py").read_text()
    counts = "        self.n = getattr(self, 'n', 0) + 1\n        belief = belief + self.n\n        dt = radar"
    (tmp_path / "mine.py").write_text(text.replace("        dt = radar", counts, 1))
    wrong = {one.check: one.found for one in kit.check(f"{tmp_path}/mine.py:Bootstrap") if not one.ok}
    assert wrong["snapshot"] == "goes on otherwise from a snapshot, or beside another track, after dwell 1"


def test_a_disturbance_of_another_power_is_found(tmp_path: Path) -> None:
    head = "import numpy as np\n\n\nclass D:\n    def draw(self, n, rng):\n        return 3.0 * rng.normal(size=n)\n"
    more = "    def power_spectrum(self, nu):\n        return np.ones(np.shape(nu))\n"
    (tmp_path / "mine.py").write_text(head + more)
    (level,) = [one for one in kit.check(f"{tmp_path}/mine.py:D") if one.check == "level"]
    assert not level.ok
    assert 8.8 < float(level.found.split()[2].rstrip(",")) < 9.2


def test_what_is_no_file_to_be_checked_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.py").write_text("x = 1\n")
    for name, said in (
        ("empty.py", "has nothing of rule, belief, strategy"),
        ("nowhere.py", "No such file"),
        ("empty.py:y", "there is no y"),
    ):
        with pytest.raises(BadInput, match=said):
            kit.check(str(tmp_path / name))
    with pytest.raises(BadInput, match="must be one of belief, disturbance, feed, front-end, objective"):
        templates.write("motion", tmp_path / "mine.py")
    templates.write("rule", tmp_path / "mine.py")
    with pytest.raises(BadInput, match="is there already"):
        templates.write("rule", tmp_path / "mine.py")


def test_a_front_end_that_is_no_file_is_named_with_a_command_that_asks_it(tmp_path: Path) -> None:
    file = str(tmp_path / "made.db")
    with closing(Store(Journal(file, owner="x"))) as store:
        run = in_process.play(smoke_start(dwells=3), store=store).run["run"]
    for name, asks in (
        ("zenoh:roof@tcp/127.0.0.1:7448", "zenoh:roof@tcp/127.0.0.1:7448"),
        (f"recorded:{file}", f"recorded:{file}#{run}"),
    ):
        done = CliRunner().invoke(app, ["check", name])
        assert (done.exit_code, done.stdout) == (2, "")
        assert f"only a run can ask it: cogradar run SCENARIO --front-end '{asks}'" in done.stderr
        open_front_end(asks)
    for name, wrong in (("zenoh:roof", "say where it listens"), ("recorded:no.db", "no such file")):
        done = CliRunner().invoke(app, ["check", name])
        assert (done.exit_code, wrong in done.stderr, "only a run" in done.stderr) == (2, True, False)


def test_a_check_says_what_it_tries_before_it_does(tmp_path: Path) -> None:
    file, opened = tmp_path / "mine.py", tmp_path / "opened"
    file.write_text(
        "from pathlib import Path\n\n\nclass Mine:\n    def __init__(self, settings):\n"
        f"        Path({str(opened)!r}).touch()\n        raise OSError('no cable')\n\n"
        "    def transmit(self, k, t, waveform):\n        pass\n\n    def close(self):\n        pass\n"
    )

    def stop(said: str) -> None:
        raise KeyboardInterrupt(said)

    with pytest.raises(KeyboardInterrupt, match=rf"^front-end {file}:Mine is tried$"):
        kit.check(str(file), report=stop)
    assert not opened.exists()
    done = CliRunner().invoke(app, ["check", str(file)])
    assert (done.exit_code, opened.exists()) == (1, True)
    assert f"front-end {file}:Mine is tried" in done.stderr
