"""The linear equations of the benchmarks, in the forms of all packages."""

import pytest

from benchmarks.linear import linear_solver
from benchmarks.linear_cases import dop853, linear_cases, qutip_solver


@pytest.fixture(scope="module")
def problems():
    return list(linear_cases(quick=False))


def test_solutions_agree_with_those_of_scipy(problems):
    for problem in problems:
        run = dop853(problem)(1e-8)
        assert problem.case.error(run.points[-1]) < 1e-6
        assert run.evaluations > 0


def test_solutions_agree_with_those_of_qutip(problems):
    pytest.importorskip("qutip")
    solved = [problem for problem in problems if problem.hamiltonians is not None]
    assert len(solved) == 3
    for problem in solved:
        assert problem.case.error(qutip_solver(problem)(1e-9).points[-1]) < 1e-6


def test_magnus_methods_are_counted(problems):
    run = linear_solver(problems[0], "CFM8(4)")(1e-6)
    assert run.flows > run.evaluations > 0
    assert problems[0].case.error(run.points[-1]) < 1e-5
