"""A build is what computes: the program, its libraries, and the machine's arithmetic."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from cogradar.shared.protocol.build import build, difference

CPU = Path("/proc/cpuinfo")
HAS_FMA = platform.libc_ver()[0] == "glibc" and CPU.exists() and " fma " in CPU.read_text()
# glibc then computes as on a processor of 2010, in this process alone.
WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable"}


def built(variables: dict[str, str]) -> str:
    command = [sys.executable, "-c", "from cogradar.shared.protocol.build import build; print(build())"]
    return subprocess.run(
        command, env=os.environ | variables, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.skipif(not HAS_FMA, reason="needs glibc, and a processor with fused multiply-add to do without")
def test_a_machine_that_computes_otherwise_is_of_another_build() -> None:
    other = built(WITHOUT_FMA)
    assert other != build()
    assert difference(other, build()).startswith("computes otherwise (arithmetic ")
    assert built({"NPY_DISABLE_CPU_FEATURES": "", "OPENBLAS_CORETYPE": "Nehalem"}) == build()


def test_another_program_is_named_whatever_it_computes() -> None:
    assert difference("1f3a-00000000", "9c2e-00000000") == "runs build 1f3a-00000000, this system 9c2e-00000000"
