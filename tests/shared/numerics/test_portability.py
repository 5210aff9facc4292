"""What differs between processors is called in no room whose numbers reach a message (ADR 42)."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
ROOMS = (
    *(f"shared/{room}" for room in ("planning", "power", "protocol", "scenario", "signal", "tracking", "world")),
    *(f"services/{role}" for role in ("allocator", "emulator", "planner")),
)
# Differ outside of kernels; in kernels those of the first line call the C library.
LIBRARY = {"exp", "expm1", "log", "log10", "log1p", "log2", "exp2", "tan", "tanh", "arctan", "arctan2", "arcsin"}
LIBRARY |= {"arccos", "power", "sinh", "cosh", "arccosh", "arcsinh", "arctanh", "float_power", "logaddexp"}
NOWHERE = {"linalg", "fft", "hypot", "cbrt", "dot", "vdot", "matmul", "einsum", "tensordot", "inner", "convolve"}
NOWHERE |= {"correlate", "poly", "polyfit", "polyval", "polynomial", "interp", "cov", "corrcoef", "kron", "trapezoid"}
NOWHERE |= {"angle", "geomspace", "logspace", "unwrap"}
# Of Python's `math`, also in kernels: C libraries round them apart (glibc 2.43 and those before it).
C_LIBRARY = {"erf", "erfc", "gamma", "lgamma", "asinh", "acosh", "atanh", "sinh", "cosh", "tanh", "cbrt", "exp2"}
# Of SciPy: the same bytes everywhere (ADR 42), or not numbers at all.
SCIPY = {"chndtr", "linear_sum_assignment", "minimize_scalar", "Akima1DInterpolator", "loadmat", "whosmat"}
SCIPY |= {"MatReadError"}
EXCEPTIONS = {
    "shared/signal/detector/calibration.py": "what `cogradar calibrate` says of recorded data",
    "shared/signal/detector/noise_faults.py": "what `cogradar calibrate` says of recorded data",
    "shared/power/max_min.py:kkt_residuals": "a check of `cogradar verify` and of the tests",
    "shared/power/sdp_reference.py:__init__": "expressions of cvxpy, which are no numbers yet",
    "shared/protocol/fields.py:_is_small": "whether a message has numbers that are far too large",
    "shared/protocol/admission.py:_is_mixture": "a view of diagonals",
    "shared/scenario/cross_checks.py": "whether a scenario is refused",
    "services/emulator/front_end.py:calibrate": "what `cogradar calibrate` says of recorded data",
}


def test_rooms_call_portable_functions_alone() -> None:
    found = [one for room in ROOMS for file in sorted((ROOT / room).rglob("*.py")) for one in calls(file)]
    assert not found, "\n".join(found)


def calls(file: Path) -> Iterator[str]:
    """What a file calls that it must not, with its place."""
    name = str(file.relative_to(ROOT))
    if name in EXCEPTIONS:
        return
    yield from _calls(ast.parse(file.read_text()), name, "", is_kernel=False)


def _calls(node: ast.AST, file: str, function: str, *, is_kernel: bool) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef):
        function = node.name
        is_kernel = any(isinstance(one, ast.Name) and one.id in {"kernel", "inlined"} for one in node.decorator_list)
        if f"{file}:{function}" in EXCEPTIONS:
            return
    if forbidden := _of_the_c_library(node) or _forbidden(node, is_kernel=is_kernel):
        yield f"{file}:{getattr(node, 'lineno', 0)}: {forbidden}"
    for child in ast.iter_child_nodes(node):
        yield from _calls(child, file, function, is_kernel=is_kernel)


def _of_the_c_library(node: ast.AST) -> str:
    if isinstance(node, ast.ImportFrom) and node.module == "math":
        return ", ".join(f"math.{one.name}" for one in node.names if one.name in C_LIBRARY)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "math":
        return f"math.{node.attr}" if node.attr in C_LIBRARY else ""
    return ""


def _forbidden(node: ast.AST, *, is_kernel: bool) -> str:
    is_method = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "dot"
    if is_method or (isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult)):
        return "@: take `product`"
    if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("scipy"):
        return ", ".join(one.name for one in node.names if one.name not in SCIPY)
    if isinstance(node, ast.Import):
        return ", ".join(one.name for one in node.names if one.name.startswith("scipy"))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "exp":
        is_complex = any(isinstance(one, ast.Constant) and isinstance(one.value, complex) for one in ast.walk(node))
        return "" if is_complex or is_kernel or not _is_numpy(node.func) else "np.exp of real numbers"
    if isinstance(node, ast.Attribute) and _is_numpy(node) and node.attr != "exp":
        return f"np.{node.attr}" if node.attr in NOWHERE or (node.attr in LIBRARY and not is_kernel) else ""
    return ""


def _is_numpy(node: ast.Attribute) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id == "np"


@pytest.mark.parametrize(
    ("line", "is_found"),
    [
        ("a @ b", True),
        ("np.exp(x)", True),
        ("np.exp(2j * x)", False),
        ("np.linalg.norm(x)", True),
        ("x.T.dot(y)", True),
        ("np.sqrt(x)", False),
        ("from scipy.special import i0e", True),
        ("from math import erfc, exp", True),
        ("@kernel\ndef f(x): return math.erf(x)", True),
        ("from math import exp, log", False),
        ("from scipy.special import chndtr", False),
        ("@kernel\ndef f(x): return np.exp(x)", False),
        ("@kernel\ndef f(x): return np.hypot(x, x)", True),
    ],
)
def test_rule_finds_what_it_is_for(line: str, is_found: bool) -> None:
    assert bool(list(_calls(ast.parse(line), "x.py", "", is_kernel=False))) == is_found


def test_every_exception_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    places = dict(EXCEPTIONS)
    monkeypatch.setattr(sys.modules[__name__], "EXCEPTIONS", {})
    for place in places:
        file, _, function = place.partition(":")
        tree: ast.AST = ast.parse((ROOT / file).read_text())
        if function:
            tree = next(one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef) and one.name == function)
        assert list(_calls(tree, file, "", is_kernel=False)), place
