"""Output between steps: it never changes the steps, and is finite and accurate on every frame."""

import numpy as np
import pytest
from frame_examples import FRAMES, generic, name
from scipy import sparse
from scipy.integrate import solve_ivp

import cg
from cg.frames import FieldFrame, LinearAction, MatrixFrame, Power, Product, Sphere

# two generators, whose orbits have more dimensions
PAIR = 0.6 * np.random.default_rng(0).standard_normal((2, 5, 5))
MATRICES = MatrixFrame(PAIR, columns=1)
KNIFE_EDGE = FieldFrame(  # moves along its direction and turns
    [lambda y: np.array([np.cos(y[2]), np.sin(y[2]), 0.0]), lambda y: np.array([0.0, 0.0, 1.0])],
    lambda v, y: y + np.array([
        v[0] * np.sinc(v[1] / (2 * np.pi)) * np.cos(y[2] + v[1] / 2),
        v[0] * np.sinc(v[1] / (2 * np.pi)) * np.sin(y[2] + v[1] / 2), v[1],
    ]),
    point_shape=3, random_point=lambda rng: rng.standard_normal(3),
)  # fmt: skip
NARROW = [
    MATRICES, KNIFE_EDGE, LinearAction([sparse.csr_array(g) for g in PAIR]),
    LinearAction(list(1j * (PAIR + PAIR.mT))), LinearAction(list(PAIR), columns=2),
    Product(MATRICES, Sphere(2)), Product(LinearAction(list(PAIR)), LinearAction(list(PAIR))),
    Power(KNIFE_EDGE, 2), Power(LinearAction(list(PAIR)), 2),
]  # fmt: skip
TIMES = np.array([0.0, 0.03, 0.5, 0.51, 0.97, 1.0])


def check_outputs(frame, **options):
    """Return a solution with output times, after comparing steps of several kinds of output."""
    f, y0 = generic(frame)
    options["frame"] = frame
    plain = cg.solve_ivp(f, (0, 1), y0, **options)
    output = cg.solve_ivp(f, (0, 1), y0, t_eval=TIMES, **options)
    dense = cg.solve_ivp(f, (0, 1), y0, dense_output=True, **options)
    events = cg.solve_ivp(f, (0, 1), y0, events=lambda t, y: np.sin(8 * t) - 0.3, **options)
    for run in (output, dense, events):
        assert run.steps == plain.steps
        np.testing.assert_array_equal(run.y[-1], plain.y[-1])
    np.testing.assert_array_equal(dense.sol.ts, plain.t)
    np.testing.assert_array_equal(events.t, plain.t)
    assert np.isfinite(output.y).all()
    np.testing.assert_allclose(dense.sol(TIMES), output.y, rtol=0, atol=1e-13)
    return output


@pytest.mark.parametrize("tolerance", [0.3, 1e-4])
@pytest.mark.parametrize("frame", FRAMES, ids=name)
def test_output_does_not_change_steps(frame, tolerance):
    check_outputs(frame, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("method", ["auto", "BS3(2)", "CG4(3)", "CF4", "LieEuler"])
@pytest.mark.parametrize("frame", NARROW, ids=name)
def test_where_fields_do_not_span(frame, method):
    fixed = method in ("CF4", "LieEuler")
    output = check_outputs(
        frame, method=method, **{"h": 0.25} if fixed else {"rtol": 1e-4, "atol": 1e-4}
    )
    if not fixed:
        f, y0 = generic(frame)
        exact = cg.solve_ivp(f, (0, 1), y0, frame=frame, rtol=1e-8, atol=1e-8, t_eval=TIMES)
        assert np.abs(output.y - exact.y).max() < 1e-3


@pytest.mark.parametrize(("method", "order"), [("CG3", 3), ("CG4a", 4), ("CF4", 4)])
def test_order_between_steps_where_fields_do_not_span(method, order):
    f, y0 = generic(MATRICES)
    exact = solve_ivp(
        lambda t, y: np.tensordot(f(t, y[:, None]), PAIR, 1) @ y, (0, 1), y0[:, 0],
        method="DOP853", rtol=1e-13, atol=1e-13, dense_output=True,
    )  # fmt: skip
    errors = []
    for n in (4, 8):
        times = (np.arange(n)[:, None] + [0.2, 0.5, 0.8, 0.999999]).ravel() / n
        run = cg.solve_ivp(f, (0, 1), y0, frame=MATRICES, method=method, h=1 / n, t_eval=times)
        errors.append(np.abs(run.y[..., 0] - exact.sol(times).T).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.4
