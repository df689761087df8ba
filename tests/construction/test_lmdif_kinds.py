"""lmdif in double and quadruple precision, compiled with run-time checks."""

from __future__ import annotations

import math
import subprocess
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import pytest
from minpack_libraries import HAS_COMPILER, TESTS, compile_fortran
from more_garbow_hillstrom import BARD

pytestmark = pytest.mark.skipif(not HAS_COMPILER, reason="gfortran not found")


@dataclass(frozen=True)
class Outcome:
    info: int
    nfev: int
    norm: Fraction
    x: tuple[Fraction, ...]


@pytest.fixture(scope="module", params=["r64", "r128"])
def outcomes(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[float, dict[str, Outcome]]:
    """Return the machine precision of the kind and the fits of its program, by problem."""
    folder: Path = tmp_path_factory.mktemp(request.param)
    source = TESTS / "fortran" / "solve_both_kinds.f90"
    program = compile_fortran(folder, request.param, source, "solve")
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    fits = {}
    for line in done.stdout.splitlines():
        name, info, nfev, norm, *x = line.split()
        fits[name] = Outcome(int(info), int(nfev), Fraction(norm), tuple(map(Fraction, x)))
    return {"r64": 2.0**-52, "r128": 2.0**-112}[request.param], fits


def test_zero_residuals_are_found_to_the_precision_of_the_kind(
    outcomes: tuple[float, dict[str, Outcome]],
) -> None:
    eps, fits = outcomes
    for name in ("rosenbrock", "helical-valley"):
        assert fits[name].info in (2, 4)
        assert fits[name].norm < 10 * eps
    assert max(abs(x - 1) for x in fits["rosenbrock"].x) < 10 * eps


def test_minimum_is_found_to_the_precision_of_the_differences(
    outcomes: tuple[float, dict[str, Outcome]],
) -> None:
    # The residuals are rational: their gradient where the solver stopped is computed exactly.
    eps, fits = outcomes
    x = fits["bard"].x
    gradient = [Fraction(0)] * 3
    square = Fraction(0)
    for u, datum in enumerate(BARD, start=1):
        v = 16 - u
        w = min(u, v)
        bottom = x[1] * v + x[2] * w
        f = Fraction(str(datum)) - (x[0] + u / bottom)
        square += f * f
        for j, slope in enumerate((-1, u * v / bottom**2, u * w / bottom**2)):
            gradient[j] += f * slope
    assert fits["bard"].info in (1, 2, 3)
    assert max(map(abs, gradient)) < 10 * math.sqrt(eps)
    assert abs(fits["bard"].norm ** 2 - square) < 10 * eps


def test_norms_at_the_ends_of_the_range(outcomes: tuple[float, dict[str, Outcome]]) -> None:
    eps, fits = outcomes
    for name in ("norm-large", "norm-small", "norm-mixed"):
        assert abs(fits[name].norm ** 2 - 2) < 10 * eps
    assert fits["norm-of-none"].norm == 0


def test_too_few_residuals_are_refused(outcomes: tuple[float, dict[str, Outcome]]) -> None:
    refused = outcomes[1]["too-few-residuals"]
    assert (refused.info, refused.nfev) == (0, 0)


@pytest.mark.parametrize(
    ("name", "info", "nfev"),
    [("stops-at-once", -7, 1), ("stops-in-differences", -7, 3), ("stops-at-trial", -7, 4)],
)
def test_a_negative_flag_stops_the_solver(
    outcomes: tuple[float, dict[str, Outcome]], name: str, info: int, nfev: int
) -> None:
    stopped = outcomes[1][name]
    assert (stopped.info, stopped.nfev) == (info, nfev)
    assert stopped.x == (5, 5)
