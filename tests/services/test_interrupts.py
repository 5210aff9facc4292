"""A Ctrl-C waits until compiled code is over, and a second one does not."""

import subprocess
import sys

import pytest

PROGRAM = """
import os, signal
from cogradar.services.errors import with_interrupts_after

signal.signal(signal.SIGINT, HANDLER)
try:
    with with_interrupts_after():
        for _ in range(TIMES):
            os.kill(os.getpid(), signal.SIGINT)
        print("done")
except KeyboardInterrupt:
    print("interrupted")
print(signal.getsignal(signal.SIGINT) is HANDLER)
"""


@pytest.mark.parametrize(
    ("handler", "times", "said"),
    [
        ("signal.default_int_handler", 0, ["done", "True"]),
        ("signal.default_int_handler", 1, ["done", "interrupted", "True"]),
        ("signal.default_int_handler", 2, ["interrupted", "True"]),
        ("signal.SIG_IGN", 1, ["done", "True"]),
    ],
)
def test_the_first_one_waits(handler: str, times: int, said: list[str]) -> None:
    program = PROGRAM.replace("HANDLER", handler).replace("TIMES", str(times))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == said
