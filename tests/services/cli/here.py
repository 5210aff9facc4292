"""Commands in the process of the tests, without the second of work that a process takes to start."""

import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import pytest

from cogradar.services.cli import app


def here(*arguments: str) -> subprocess.CompletedProcess[str]:
    """What a command prints, and its exit code; an exception that it lets out fails the test."""
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["cogradar", *arguments])
        with pytest.raises(SystemExit) as ended:
            app.main()
    return subprocess.CompletedProcess(arguments, int(ended.value.code or 0), out.getvalue(), err.getvalue())
