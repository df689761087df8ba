"""Munthe-Kaas methods in compiled code: C functions, all compiled frames."""

import numpy as np
import pytest
from compiled_examples import ORBITS, PROBLEMS
from frame_examples import generic, name
from kinds import MUNTHE_KAAS
from python_steps import Step, uncompiled

import cg
from cg.construction.catalogue import resolve_method
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


@pytest.mark.parametrize("frame", [*GROUPS, ORBITS[1], ORBITS[2], ORBITS[6]], ids=name)
@pytest.mark.parametrize("key", [*MUNTHE_KAAS, "CF4(3)", "CG4a", "DOP853"])
def test_matrices_in_compiled_code(frame, key):
    f, y0 = generic(frame)
    method = resolve_method(key)
    fixed = {"method": key, "h": 0.125}
    tight = {"method": key, "rtol": 1e-6, "atol": 1e-6}

    def both(frame):
        yield cg.integrate(f, (0, 1), y0, frame=frame, **fixed)
        if method.embedded_order:
            yield cg.solve_ivp(f, (0, 1), y0, frame=frame, dense_output=True, **tight)

    fast, slow = list(both(frame)), list(both(uncompiled(frame)))
    np.testing.assert_allclose(fast[0].y, slow[0].y, rtol=0, atol=1e-13)
    assert frame.relative_error(fast[0].y).max() < 2e-15
    if method.embedded_order:
        assert (fast[1].steps, fast[1].nfev) == (slow[1].steps, slow[1].nfev)
        np.testing.assert_allclose(fast[1].y[-1], slow[1].y[-1], rtol=0, atol=1e-9)
        t = np.linspace(0, 1, 5)
        np.testing.assert_allclose(fast[1].sol(t), slow[1].sol(t), rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", range(1, 13))
@pytest.mark.parametrize("frame", [*GROUPS, *ORBITS], ids=name)
def test_the_series_in_compiled_code(frame, order):
    u, v = np.random.default_rng(0).standard_normal((2, 3, frame.dim))
    if frame in ORBITS:  # within the radius of convergence
        u /= 4
    expected = frame.dexpinv(u, v, order=order)
    values = dexpinv_of(frame, order)(u, v)
    np.testing.assert_allclose(values, expected, rtol=1e-13, atol=1e-13)
