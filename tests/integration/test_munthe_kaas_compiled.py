"""Munthe-Kaas methods in compiled code: C functions, all compiled frames."""

import numpy as np
import pytest
from compiled_examples import ORBITS, PROBLEMS
from frame_examples import name
from kinds import MUNTHE_KAAS
from python_steps import Step

import cg
from cg.frames import SO, SU, Power, U
from cg.integration.plan.blocks import dexpinv_of


@pytest.mark.parametrize("key", [key for key, method in MUNTHE_KAAS.items() if method.explicit])
@pytest.mark.parametrize("problem", PROBLEMS)
def test_compiled_code_and_python_take_the_same_steps(problem, key):
    problem, method = PROBLEMS[problem], MUNTHE_KAAS[key]
    run = cg.integrate(problem.f, (0, 1), problem.y0, frame=problem.frame, method=key, h=0.25)
    step = Step(problem.f, problem.frame, method)
    point = problem.y0
    for k in range(4):
        point = step(0.25 * k, point, 0.25)
    np.testing.assert_allclose(run.y[-1], point, rtol=1e-14, atol=1e-14)
    assert (run.nfev, run.nexp) == (step.nfev, step.nexp)
    assert run.nexp == 4 * method.exponentials


GROUPS = [SO(2), SO(4), SO(5, "space"), SU(3), SU(4, "body"), U(1), U(2), Power(SU(3), 2)]


@pytest.mark.parametrize("order", range(1, 13))
@pytest.mark.parametrize("frame", [*GROUPS, *ORBITS], ids=name)
def test_the_series_in_compiled_code(frame, order):
    u, v = np.random.default_rng(0).standard_normal((2, 3, frame.dim))
    if frame in ORBITS:  # within the radius of convergence
        u /= 4
    expected = frame.dexpinv(u, v, order=order)
    values = dexpinv_of(frame, order)(u, v)
    np.testing.assert_allclose(values, expected, rtol=2e-14, atol=2e-14)
