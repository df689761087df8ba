"""Samples that each member of an ensemble has for itself."""

import numpy as np
import pytest
from driven_bodies import FRAME, GUST, START, TIGHT, TIMES, driven

import cg

MEMBERS = 7
OF_EACH = np.random.default_rng(5).standard_normal((MEMBERS, 8, 3))
OWN = cg.Samples(TIMES, OF_EACH, members=True)
GAINS = np.linspace(0.5, 2.0, MEMBERS)[:, None]
EACH = {"frame": FRAME, "parameters": GAINS, "inputs": (OWN, GUST), **TIGHT}
ALONE = {"frame": FRAME, **TIGHT}


def driven_rows(t, y, u, p):
    moment, gust = u
    slope = p[:, :1] * moment - y[:, 9:]
    slope[:, 0] += gust
    return np.concatenate([y[:, 9:], slope], axis=1)


def alone(k, **options):
    own = cg.Samples(TIMES, OF_EACH[k])
    return cg.solve_ivp(
        driven, (0, 2.4), START, parameters=GAINS[k], inputs=(own, GUST), **ALONE | options
    )


@pytest.mark.parametrize("workers", [{}, {"workers": 2}, {"executor": "processes", "workers": 2}])
@pytest.mark.parametrize("kind", ["python", "vectorized", "compiled"])
def test_members_have_inputs_of_their_own(workers, kind, library):
    f = {
        "python": driven,
        "vectorized": driven_rows,
        "compiled": cg.CompiledFunction(library._name, "blown"),
    }[kind]
    run = cg.solve_ensemble(
        f, (0, 2.4), START, vectorized=kind == "vectorized", t_eval=[0.0, 1.1, 2.4], **workers,
        **EACH,
    )  # fmt: skip
    for k in range(MEMBERS):
        expected = alone(k, t_eval=[0.0, 1.1, 2.4]).y
        atol = 0.0 if kind == "python" else 1e-13
        np.testing.assert_allclose(run.y[:, k], expected, rtol=0, atol=atol)


@pytest.mark.parametrize("kind", ["python", "vectorized", "compiled"])
def test_derivatives_of_members(kind, function):
    f = {"python": driven, "vectorized": driven_rows, "compiled": function("blown")}[kind]
    run = cg.solve_variational_ensemble(
        f, (0, 1.5), START, vectorized=kind == "vectorized", workers=2,
        events=lambda t, y, u, p: y[9] - u[1], **EACH,
    )  # fmt: skip
    for k in (0, MEMBERS - 1):
        expected = cg.solve_variational(
            driven, (0, 1.5), START, parameters=GAINS[k],
            inputs=(cg.Samples(TIMES, OF_EACH[k]), GUST), **ALONE,
        )  # fmt: skip
        for name in ("transition", "sensitivity"):
            got, want = getattr(run[k], name)[-1], getattr(expected, name)[-1]
            np.testing.assert_allclose(got, want, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("solve", "f"),
    [
        (cg.solve_ensemble, lambda t, y, u, p=(1.0,): [u * p[0]]),
        (cg.solve_linear_ensemble, lambda t, u, p=(1.0,): [u * p[0]]),
        (cg.solve_variational_ensemble, lambda t, y, u, p=(1.0,): [u * p[0]]),
    ],
)
@pytest.mark.parametrize("factor", [None, 2.0])
@pytest.mark.parametrize("together", [False, True])
def test_one_point_serves_all_members_of_inputs(solve, f, factor, together):
    own = cg.Samples([0.0, 1.0], [[1.0, 2.0], [2.0, 3.0], [0.0, 0.0]], "linear", members=True)
    parameters = None if factor is None else [[factor]]
    g = (lambda *a: f(*a[:-1], a[-1][0])) if factor is None else (
        lambda *a: f(*a[:-2], a[-2][0], a[-1]))  # fmt: skip
    run = solve(
        g if together else f, (0, 1), [0.0], frame=cg.frames.Euclidean(1),
        inputs=(own,) if together else own, parameters=parameters,
    )  # fmt: skip
    assert np.allclose(run.y[-1, :, 0], (factor or 1.0) * np.array([1.5, 2.5, 0.0]), atol=1e-9)
