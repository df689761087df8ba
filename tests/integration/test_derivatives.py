"""Right-hand sides that return derivatives of points, rhs="derivative"."""

import numpy as np
import pytest
from frame_examples import FRAMES
from frame_examples import name as frame_name
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import cg
from cg.frames import Power, Product, Stiefel, check
from cg.frames.stiefel import LowRankStiefel

SIZES = [(5, 1), (4, 2), (3, 3), (9, 4)]
FINE = {"rtol": 1e-10, "atol": 1e-10, "rhs": "derivative"}


class Family:
    """Derivatives S(t, y) y of columns with a random skew matrix S, which turn them too."""

    def __init__(self, n, k, seed):
        rng = np.random.default_rng((n, k, seed))
        self.frame = Stiefel(n, k)
        self.skew, self.driven = (x - x.T for x in rng.standard_normal((2, n, n)) / np.sqrt(n))
        self.metric = rng.standard_normal((n, n)) / np.sqrt(n)
        self.y0 = self.frame.random_point(rng)

    def generator(self, t, y):
        """Return S."""
        product = self.metric @ y @ y.mT
        return self.skew + np.cos(t) * self.driven + product - product.mT

    def __call__(self, t, y):
        """Return the derivative."""
        return self.generator(t, y) @ y

    def exact(self, end):
        """Return the solution of the equation of the entries."""

        f = lambda t, y: self(t, y.reshape(self.y0.shape)).ravel()
        run = solve_ivp(f, (0, end), self.y0.ravel(), method="DOP853", rtol=1e-13, atol=1e-13)
        return run.y[:, -1].reshape(self.y0.shape)


@pytest.mark.parametrize(("n", "k"), SIZES)
def test_axioms_and_solutions(n, k):
    for seed in range(3):
        problem = Family(n, k, seed)
        check(LowRankStiefel(n, k), rng=np.random.default_rng(seed))
        y = cg.solve_ivp(problem, (0, 2), problem.y0, frame=problem.frame, **FINE)
        assert y.frame == problem.frame
        assert problem.frame.membership_error(y.y).max() < 1e-15 * n
        np.testing.assert_allclose(y.y[-1], problem.exact(2.0), rtol=0, atol=3e-9)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-9, 1.0, 5.0])
@pytest.mark.parametrize(("n", "k"), [*SIZES, (20, 5)])
def test_flows_are_linear_fractional(n, k, size):
    frame, rng = LowRankStiefel(n, k), np.random.default_rng((n, k))
    v, y = frame.random_vector(rng, 4), frame.random_point(rng, 4)
    v *= size / np.linalg.norm(v, axis=-1, keepdims=True)
    moved = frame.flow(v, y)
    for matrix, start, end in zip(v.reshape(4, n, k), y, moved, strict=True):
        generator = np.block([[np.zeros((n, n)), matrix], [matrix.T, np.zeros((k, k))]])
        pair = expm(generator) @ np.concatenate([start, np.eye(k)])
        expected = np.linalg.solve(pair[n:].T, pair[:n].T).T
        np.testing.assert_allclose(end, expected, rtol=0, atol=1e-14 * np.exp(2.0 * size))
    assert frame.membership_error(moved).max() < 2e-15


@pytest.mark.parametrize("method", ["RKMK8(5,3)", "RadauIIA5"])
def test_methods_with_brackets_move_along_the_given_fields(method):
    problem = Family(4, 2, 8)
    options = {"frame": problem.frame, "method": method, "rtol": 1e-8, "atol": 1e-8}
    run = cg.solve_ivp(problem, (0, 1), problem.y0, rhs="derivative", **options)
    f = lambda t, y: problem.frame.coefficients(y, problem(t, y))
    expected = cg.solve_ivp(f, (0, 1), problem.y0, **options)
    np.testing.assert_allclose(run.y[-1], expected.y[-1], rtol=0, atol=1e-14)


@pytest.mark.parametrize("given", [Stiefel(3, 2), Power(Stiefel(3, 1), 2)], ids=frame_name)
@pytest.mark.parametrize("span", [(0.0, 1.0), (1.0, 0.0)])
def test_solutions_have_derivatives(given, span):
    """In coordinates of the given frame."""
    rng = np.random.default_rng(6)
    y0, (skew, metric) = given.random_point(rng), rng.standard_normal((2, 3, 3))

    def derivative(t, y, p):
        product = p[0] * np.cos(t) * skew + p[1] * metric @ y @ y.mT
        return (product - product.mT) @ y

    coefficients = lambda t, y, p: given.coefficients(y, derivative(t, y, p))
    options = {"frame": given, "parameters": [0.4, 0.2], "rtol": 1e-9, "atol": 1e-9}
    for kind in ("forward", "adjoint"):
        runs = [
            cg.solve_variational(f, span, y0, derivatives=kind, rhs=rhs, **options)
            for rhs, f in (("derivative", derivative), ("coefficients", coefficients))
        ]
        assert runs[0].frame == given
        first, second = (
            run.jacobian()[:2] if kind == "adjoint" else (run.transition[-1], run.sensitivity[-1])
            for run in runs
        )
        np.testing.assert_allclose(np.hstack(first), np.hstack(second), rtol=0, atol=1e-10)


def test_only_the_projection_onto_tangents_counts():
    rng = np.random.default_rng(5)
    frame, gradient = Stiefel(7, 3), rng.standard_normal((7, 3))
    y = frame.random_point(rng)
    symmetric = y.T @ gradient + gradient.T @ y
    with pytest.warns(UserWarning, match="a part that the fields"):
        tangent = frame.field(frame.coefficients(y, gradient), y)
    np.testing.assert_allclose(tangent, gradient - 0.5 * y @ symmetric, rtol=0, atol=1e-14)
    with pytest.warns(UserWarning, match="of their length, at t = ") as caught:
        run = cg.solve_ivp(lambda t, y: gradient, (0, 60), y, frame=frame, **FINE)
    assert len(caught) == 1
    left, _, right = np.linalg.svd(gradient, full_matrices=False)
    np.testing.assert_allclose(run.y[-1], left @ right, rtol=0, atol=1e-11)  # the polar factor


@pytest.mark.parametrize(
    "frame",
    [cg.frames.Sphere(2), cg.frames.UnitQuaternion(), cg.frames.SU(2), cg.frames.SU(3),
     cg.frames.SO3("space"), cg.frames.SE3(), cg.frames.SE3("space"), cg.frames.SO(4),
     cg.frames.Semidirect(cg.frames.SO3(), 2), cg.frames.SPD(3), Stiefel(4, 2), Stiefel(3, 3),
     cg.frames.IsospectralOrbit((-1.0, 0.25, 1.5)),
     cg.frames.IsospectralOrbit((0.0, 0.0, 1.0), hermitian=True),
     cg.frames.CoadjointOrbit(cg.frames.SO3(), (0.6, 0.0, -0.8))],
    ids=frame_name,
)  # fmt: skip
@pytest.mark.parametrize("size", [3.0, 0.1])
def test_reported_share_is_that_of_the_dropped_part(frame, size):
    """Of derivatives of different lengths, so that it is a quotient of lengths."""
    rng = np.random.default_rng(3)
    y = frame.random_point(rng)
    slope = size * rng.standard_normal((*y.shape, 2))[..., : 1 + np.iscomplexobj(y)]
    slope = np.ascontiguousarray(slope).view(y.dtype)[..., 0]
    v = frame._coefficients_at(y[None], slope[None])[0]
    fields = np.stack([frame.field(e, y).ravel() for e in np.eye(frame.dim)], axis=-1)
    rows, right = (np.concatenate([x.real, x.imag]) for x in (fields, slope.ravel()))
    np.testing.assert_allclose(v, np.linalg.lstsq(rows, right, 1e-12)[0], rtol=0, atol=1e-13)
    tangent = frame.field(v, y)
    share = np.linalg.norm(slope - tangent) / np.linalg.norm(slope)
    with pytest.warns(UserWarning, match=f"dropped: up to {100 * share:.3g} % of their length"):
        cg.integrate(
            lambda t, y: slope, (0, 1e-9), y, frame=frame, method="LieEuler", h=1e-9,
            rhs="derivative",
        )  # fmt: skip


def test_what_it_refuses():
    frame = Stiefel(4, 2)
    y0 = np.eye(4, 2)
    with pytest.raises(ValueError, match=r"f must return an array of shape \(4, 2\), got shape"):
        cg.solve_ivp(lambda t, y: np.zeros(8), (0, 1), y0, frame=frame, rhs="derivative")
    with pytest.raises(ValueError, match="rhs='derivative' takes derivatives of y"):
        cg.solve_ivp(lambda t, y: y, (0, 1), y0, frame=frame)
    with pytest.raises(OverflowError, match="can't be computed in double precision"):
        LowRankStiefel(4, 2).flow(np.full(8, 1e4), y0)
    with pytest.raises(TypeError, match=r"rhs must be one of .coefficients., .*, got None"):
        cg.solve_ivp(lambda t, y: y, (0, 1), y0, frame=frame, rhs=None)
    space = cg.frames.PhaseSpace(cg.frames.SO3())
    with pytest.raises(ValueError, match="rhs must be 'coefficients' on a phase space"):
        cg.solve_ivp(lambda t, y: y, (0, 1), np.zeros(12), frame=space, rhs="derivative")
    options = {"frame": cg.frames.SO3(), "linear": True, "rhs": "derivative"}
    with pytest.raises(ValueError, match="rhs must be 'coefficients' with linear=True"):
        cg.solve_ivp(lambda t: np.zeros(3), (0, 1), np.eye(3), **options)


def coefficients(t, y):
    """Return coefficients of a quaternion and a vector."""
    return np.array([y[4], y[5], y[6], y[0], np.cos(t), -y[1] * y[4]])


BODY = Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
Y0 = np.array([0.0, 0.6, 0.0, 0.8, 1.0, 2.0, -0.5])


def derivative(t, y):
    """Return the derivative that has these coefficients."""
    return BODY.field(coefficients(t, y), y)


@pytest.mark.parametrize("frame", FRAMES, ids=frame_name)
def test_every_frame_takes_derivatives(frame):
    rng = np.random.default_rng(4)
    y0 = frame.random_point(rng)
    numbers = lambda y: np.ascontiguousarray(y).reshape(-1).view(float)
    along = 0.3 * rng.standard_normal((frame.dim, numbers(y0).size)) / np.square(y0.size)
    f = lambda t, y: np.cos(t) * np.arange(1.0, frame.dim + 1) / frame.dim + along @ numbers(y)
    f_of_derivative = lambda t, y: frame.field(f(t, y), y).tolist()
    options = {"frame": frame, "method": "CF5(4)", "h": 0.02}
    v = rng.standard_normal(frame.dim)
    is_unique = np.allclose(frame.coefficients(y0, frame.field(v, y0)), v)
    # with isotropy points move along other flows
    bound = (1e-13 if is_unique else 1e-7) * max(1.0, np.abs(y0).max())
    for span in ((0, 0.2), (0.2, -0.1), (1, 1)):
        expected = cg.solve_ivp(f, span, y0, **options)
        found = cg.solve_ivp(f_of_derivative, span, y0, rhs="derivative", **options)
        assert found.nfev == expected.nfev
        np.testing.assert_allclose(found.y, expected.y, rtol=0, atol=bound)
    if frame.dtype.kind == "c":
        with pytest.raises(ValueError, match="f must return "):
            cg.solve_ivp(lambda t, y: ["a"], (0, 1), y0, rhs="derivative", frame=frame)


def test_values_that_are_not_finite_reject_steps_and_end_equal_ones():
    f = lambda t, y: derivative(t, y) * (1.0 if t < 0.5 else np.nan)
    run = cg.solve_ivp(f, (0, 1), Y0, frame=BODY, rhs="derivative")
    assert run.status == -1
    assert 0.49 < run.t[-1] <= 0.5
    pull = lambda t, y: derivative(t, y) + np.append(0.1 * y[:4], np.zeros(3))
    with pytest.warns(UserWarning, match=r"which is dropped: up to \d.* % of") as caught:
        drawn = cg.solve_ensemble(pull, (0, 1), [Y0, Y0], frame=BODY, rhs="derivative")
    assert len(caught) == 1
    np.testing.assert_allclose(
        drawn.y[-1, 0], cg.solve_ivp(coefficients, (0, 1), Y0, frame=BODY).y[-1], rtol=0, atol=3e-14
    )


@pytest.mark.parametrize("convention", ["body", "space"])
def test_singular_points_have_no_coefficients(convention):
    frame = cg.frames.Semidirect(cg.frames.GL(2, convention))
    y = np.stack([np.diag([1.0, 0.0, 1.0]), np.eye(3)])
    v = frame.coefficients(y, frame.field(np.arange(1.0, 7.0), y))
    assert np.isnan(v[0]).all()
    np.testing.assert_allclose(v[1], np.arange(1.0, 7.0), rtol=1e-14)


class InPython(cg.frames.SO3):
    """Rotations that compiled code doesn't know."""


@pytest.mark.parametrize("make", [cg.frames.SO3, InPython], ids=["compiled", "Python"])
@pytest.mark.parametrize("derivatives", [None, "forward"])
def test_equal_frames_serve_coefficients_and_derivatives_in_turn(make, derivatives):
    """They share what is kept for a frame: plans, and products with derivatives."""
    f = lambda t, y: np.array([np.cos(t), y[0, 1], 0.3])
    f_of_derivative = lambda t, y: make().field(f(t, y), y)
    options = {"rtol": 1e-10, "atol": 1e-10, "derivatives": derivatives}
    kept = {}
    for rhs in 2 * ["coefficients", "derivative"]:
        given = f if rhs == "coefficients" else f_of_derivative
        run = cg.solve_ivp(given, (0, 1), np.eye(3), frame=make(), rhs=rhs, **options)
        assert run.frame == make()
        np.testing.assert_array_equal(run.y, kept.setdefault(rhs, run).y)
        np.testing.assert_allclose(run.y[-1], kept["coefficients"].y[-1], rtol=0, atol=1e-12)
        if derivatives:
            transition = kept["coefficients"].transition[-1]
            np.testing.assert_allclose(run.transition[-1], transition, rtol=0, atol=1e-7)


def test_plans_of_equal_frames_for_derivatives_are_those_of_the_users_frame():
    f = lambda t, y: np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 2.0], [0.0, -2.0, 0.0]]) @ y
    for frame in (Stiefel(3, 2), LowRankStiefel(3, 2), Stiefel(3, 2)):
        run = cg.solve_ivp(f, (0, 1), np.eye(3, 2), frame=frame, rhs="derivative")
        assert run.frame == frame
        assert type(run.frame) is type(frame)
