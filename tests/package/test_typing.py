"""Type hints of the public interface, checked by mypy on user code."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import cg

pytest.importorskip("mypy")
pytestmark = [pytest.mark.slow, pytest.mark.no_core]  # mypy reads NumPy's types

RIGHT = """
import numpy as np
from numpy.typing import NDArray

import cg
import crouch_grossman

frame = cg.frames.Product(cg.frames.SO3(), cg.frames.Euclidean(3))


def f(t: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
    attitude, momentum = frame.split(y)
    return np.concatenate([momentum, 0.0 * momentum])


y0 = frame.join(np.eye(3), np.array([0.3, 0.1, 0.9]))
run = cg.integrate(f, (0, 1), y0, frame=frame, method="CG4a", h=0.05)
end: NDArray[np.float64] = run.y[-1]
solution = cg.solve_ivp(f, (0, 1), y0, frame=frame, rtol=1e-8, atol=1e-8, dense_output=True)
count: int = solution.nfev
in_c = cg.CompiledFunction("./top.so", "rhs", [1.0])
end = cg.integrate(in_c, (0, 1), y0, frame=frame, method="CF4", h=0.05).y[-1]
count = cg.solve_ivp(in_c, (0, 1), y0, frame=frame).nfev
method = cg.methods["CG4a"]
order: int = method.order
found = crouch_grossman.search(order=3, stages=3, starts=4, seed=1).methods
names: list[str] = list(cg.methods)
"""
WRONG = """
import cg

order: str = cg.methods["CG4a"].order
cg.integrate(lambda t, y: y, (0, 1), [1.0], frame=cg.frames.SO3(), methid="CG4a", h=0.05)
"""


def check(folder, text):
    (folder / "user.py").write_text(text, encoding="utf-8")
    root = Path(cg.__file__).parents[1]
    path = {} if root.name == "site-packages" else {"MYPYPATH": str(root)}
    return subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "user.py"], cwd=folder,
        env={**os.environ, **path}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_strict_mypy_accepts_user_code(tmp_path):
    run = check(tmp_path, RIGHT)
    assert [line for line in run.stdout.splitlines() if line.startswith("user.py")] == []
    assert "user.py" not in run.stderr
    if Path(cg.__file__).parents[1].name == "site-packages":
        assert run.returncode == 0, run.stdout


def test_strict_mypy_finds_errors(tmp_path):
    output = check(tmp_path, WRONG).stdout
    assert 'has type "int", variable has type "str"' in output
    assert 'Unexpected keyword argument "methid"' in output
