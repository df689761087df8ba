"""Methods of Munthe-Kaas in compiled code: functions in C, all frames that it knows, real(16)."""

import ctypes

import numpy as np
import pytest
from compiled_examples import PROBLEMS
from frame_examples import name
from python_steps import Step, uncompiled
from test_munthe_kaas import METHODS, generic

import cg
from cg.analysis.convergence import observed_order
from cg.catalogue import resolve_method
from cg.frames import SE3, SO, SO3, SU, Power, U, UnitQuaternion
from cg.frames.dexpinv import series_dexpinv
from cg.integration.step.flows import dexpinv_of
from cg.problems.affine import AffineField
from cg.reproduce.reference_runs import integrate_affine

pytestmark = pytest.mark.sanitize

ORDERS = {
    **{key: (m, m.order) for key, m in METHODS.items()},
    **{
        f"{key}, second": (m.embedded, m.embedded_order) for key, m in METHODS.items() if m.embedded
    },
}


@pytest.fixture(scope="module", params=["SO3 body", "SE3 space"])
def solved(request):
    problem = PROBLEMS[request.param]
    return problem, problem.reference([1], bits=128).values[0][:-1]


@pytest.mark.parametrize("key", ORDERS)
def test_slopes_in_quadruple_precision(solved, key):
    (problem, exact), (method, order) = solved, ORDERS[key]
    counts = [8, 16, 32] if order > 5 else [64, 128, 256]
    errors = []
    for n in counts:
        end = integrate_affine(problem, method=method, h=f"1/{n}", steps=n, kind="real128")
        errors.append(float(max(abs(x - y) for x, y in zip(end.exact(-1), exact, strict=True))))
    slope = observed_order(1 / np.array(counts), errors, floor=1e-31)
    assert slope.order == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize("key", [key for key, method in METHODS.items() if method.explicit])
@pytest.mark.parametrize("problem", PROBLEMS)
def test_compiled_code_and_python_take_the_same_steps(problem, key):
    problem, method = PROBLEMS[problem], METHODS[key]
    run = cg.integrate(problem.f, (0, 1), problem.y0, frame=problem.frame, method=key, h=0.25)
    step = Step(problem.f, problem.frame, method)
    point = problem.y0
    for k in range(4):
        point = step(0.25 * k, point, 0.25)
    np.testing.assert_allclose(run.y[-1], point, rtol=1e-14, atol=1e-14)
    assert (run.nfev, run.nexp) == (step.nfev, step.nexp)
    assert run.nexp == 4 * method.exponentials


@pytest.mark.parametrize("key", ["RKMK3(2)", "RKMK5(4)", "RKMK8(5,3)"])
@pytest.mark.parametrize("entry", ["product", "SE3 body", "sphere", "SU2 body"])
def test_a_function_in_c_takes_the_steps_of_one_and_a_frame_in_python(entry, key, affine):
    problem = PROBLEMS[entry]
    f, _keep = affine(problem)
    options = {"method": key, "rtol": 1e-6, "atol": 1e-6, "dense_output": True}
    fast = cg.solve_ivp(f, (0.2, 2.0), problem.y0, frame=problem.frame, **options)
    frame = uncompiled(problem.frame)
    slow = cg.solve_ivp(problem.f, (0.2, 2.0), problem.y0, frame=frame, **options)
    assert (fast.steps, fast.nrejected) == (slow.steps, slow.nrejected)
    assert (fast.nfev, fast.nexp) == (slow.nfev, slow.nexp)
    # the estimate of a tiny first step is not far from rounding
    np.testing.assert_allclose(fast.t, slow.t, rtol=1e-6)
    t = np.linspace(0.2, 2.0, 7)
    np.testing.assert_allclose(fast.sol(t), slow.sol(t), rtol=0, atol=1e-9)


def test_members_of_a_function_in_c_take_steps_of_their_own(affine):
    problem = PROBLEMS["SE3 body"]
    f, _keep = affine(problem)
    points = problem.frame.random_point(np.random.default_rng(2), 5)
    options = {"frame": problem.frame, "method": "RKMK8(5,3)", "rtol": 1e-8, "atol": 1e-8}
    whole = cg.solve_ensemble(f, (0, 1), points, t_eval=[0.5, 1.0], **options)
    for i, point in enumerate(points):
        alone = cg.solve_ivp(f, (0, 1), point, t_eval=[0.5, 1.0], **options)
        np.testing.assert_array_equal(whole.y[:, i], alone.y)
    fixed = {"frame": problem.frame, "method": "RKMK5(4)", "h": 0.01}
    runs = [cg.solve_ensemble(f, (0, 1), points, workers=w, **fixed).y for w in (1, 2)]
    np.testing.assert_array_equal(*runs)


def test_a_function_may_write_into_its_point():
    def spoil(t, y, f, data):
        for i in range(3):
            f[i] = 0.3 * (i + 1) + y[i]
        for i in range(9):
            y[i] = 7.0
        return 0

    def keep(t, y):
        return 0.3 * np.arange(1.0, 4.0) + y.ravel()[:3]

    doubles = ctypes.POINTER(ctypes.c_double)
    pointer = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, doubles, doubles, ctypes.c_void_p)
    for key in METHODS:
        options = {"frame": SO3(), "method": key, "h": 0.25}
        runs = [cg.integrate(g, (0, 1), np.eye(3), **options).y for g in (pointer(spoil), keep)]
        np.testing.assert_allclose(*runs, rtol=0, atol=1e-14)


GROUPS = [SO(2), SO(4), SO(5, "space"), SU(3), SU(4, "body"), U(1), U(2), Power(SU(3), 2)]


@pytest.mark.parametrize("frame", GROUPS, ids=name)
@pytest.mark.parametrize("key", [*METHODS, "CF4(3)", "CG4a"])
def test_groups_of_matrices_in_compiled_code(frame, key):
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
    assert frame.membership_error(fast[0].y).max() < 2e-15
    if method.embedded_order:
        assert (fast[1].steps, fast[1].nfev) == (slow[1].steps, slow[1].nfev)
        np.testing.assert_allclose(fast[1].y, slow[1].y, rtol=0, atol=1e-6)
        t = np.linspace(0, 1, 5)
        np.testing.assert_allclose(fast[1].sol(t), slow[1].sol(t), rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", range(1, 13))
@pytest.mark.parametrize("frame", GROUPS, ids=name)
def test_the_series_in_compiled_code(frame, order):
    u, v = np.random.default_rng(0).standard_normal((2, 3, frame.dim))
    expected = frame.dexpinv(u, v, order=order)
    found = dexpinv_of(frame, order)(u, v)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("size", [1e-9, 0.1, 0.7, 0.99, 1.01, 2.0])
@pytest.mark.parametrize("frame", [SO3("space"), UnitQuaternion(), SE3(), SE3("space")], ids=name)
def test_sums_of_the_series_in_compiled_code(frame, size):
    """Rigid motions have another series for them at small angles, whose terms count near 1."""
    u, v = np.random.default_rng(3).standard_normal((2, frame.dim))
    u[:3] *= size / np.linalg.norm(u[:3])
    expected = series_dexpinv(lambda w: frame.bracket(u, w), v, 70)
    np.testing.assert_allclose(dexpinv_of(frame, 8)(u, v), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("key", ORDERS)
def test_slopes_on_matrices_in_quadruple_precision(key):
    method, order = ORDERS[key]
    problem = AffineField(SO(4, "space"), np.eye(4), seed=3)
    counts = [8, 16, 32] if order > 5 else [64, 128]
    ends = []
    for n in counts:
        run = integrate_affine(problem, method=method, h=f"1/{n}", steps=n, kind="real128")
        ends.append(np.array(run.exact(-1)))
    fine = integrate_affine(problem, method="RKMK8(5,3)", h="1/200", steps=200, kind="real128")
    exact = np.array(fine.exact(-1))
    errors = [float(np.abs(end - exact).max()) for end in ends]
    slope = observed_order(1 / np.array(counts), errors, floor=1e-27)
    assert slope.order == pytest.approx(order, abs=0.3)
