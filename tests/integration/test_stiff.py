"""The collocation method RadauIIA5."""

import numpy as np
import pytest
from frame_examples import generic
from refusals import refuses
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import cg
from cg.construction.methods.paths import transformation
from cg.frames import SO3, Euclidean, Product, Sphere, Stiefel, UnitQuaternion
from cg.problems.convergence import final_errors, observed_order

PLANE = Euclidean(2)
START = [2.0, 0.0]
MU = 100.0


def van_der_pol(t, y):
    return np.array([y[1], MU * (1.0 - y[0] ** 2) * y[1] - y[0]])


def jacobian(t, y):
    return np.array([[0.0, 1.0], [-2.0 * MU * y[0] * y[1] - 1.0, MU * (1.0 - y[0] ** 2)]])


def sparse_jacobian(t, y):
    return sparse.csr_array(jacobian(t, y))


def solve(f=van_der_pol, t1=200.0, y0=START, frame=PLANE, **options):
    options = {"method": "RadauIIA5", "rtol": 1e-6, "atol": 1e-6} | options
    return cg.solve_ivp(f, (0, t1), y0, frame=frame, **options)


RADAU = cg.methods["RadauIIA5"]


def pendulum(t, y):
    return [y[1], np.sin(t) - np.sin(y[0])]


FRAMES = [
    SO3(), SO3("space"), Product(UnitQuaternion(), Euclidean(3)), Sphere(2), Euclidean(3),
    Stiefel(4, 2),
]  # fmt: skip


class TestOrder:
    @pytest.mark.parametrize("frame", FRAMES, ids=repr)
    def test_slopes(self, frame):
        f, y0 = generic(frame)
        options = {"frame": frame, "method": "RKMK8(5,3)", "rtol": 1e-13, "atol": 1e-13}
        exact = cg.solve_ivp(f, (0, 1.6), y0, **options).y[-1]
        h = np.array([0.1, 0.05, 0.025])
        errors = final_errors(f, (0, 1.6), y0, exact, frame=frame, method=RADAU, h=h)
        assert observed_order(h, errors, floor=1e-13) == pytest.approx(5.0, abs=0.1)

    def test_within_steps(self):
        frame, (f, y0) = SO3(), generic(SO3())
        t = np.linspace(0.03, 1.5, 40)
        exact = cg.solve_ivp(f, (0, 1.6), y0, frame=frame, rtol=1e-13, atol=1e-13, t_eval=t).y
        errors = []
        for h in (0.1, 0.05):
            run = cg.solve_ivp(f, (0, 1.6), y0, frame=frame, method=RADAU, h=h, t_eval=t)
            errors.append(np.abs(run.y - exact).max())
        assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)

    def test_stiff_order_on_rotations(self):
        """A rotation is drawn to a moving one: of the order of the stages, with small errors."""
        frame = SO3()

        def moving(t):
            turned = frame.flow([0.5 * np.sin(t), 0.3 * t, 0.0], np.eye(3))
            return frame.flow([0.0, 0.0, t], np.eye(3)) @ turned

        def f(t, y):
            m = y.T @ moving(t)
            error = 0.5 * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
            return 1e4 * np.array([1.0, 0.5, 2.0]) * error + np.array([0.3, 0.1 * t, 0.2])

        options = {"frame": frame, "method": RADAU}
        exact = cg.solve_ivp(f, (0, 2), moving(0.0), rtol=1e-12, atol=1e-12, **options).y[-1]
        h = np.array([0.2, 0.1, 0.05])
        errors = final_errors(f, (0, 2), moving(0.0), exact, h=h, **options)
        assert observed_order(h, errors, floor=1e-14) == pytest.approx(3.0, abs=0.3)
        assert errors[0] < 2e-8
        run = cg.solve_ivp(f, (0, 20), moving(0.0), rtol=1e-5, atol=1e-5, **options)
        assert run.nrejected < 0.4 * run.steps


@pytest.mark.parametrize(("method", "jacobians", "factors"), [(RADAU, 1, 2), ("DICG4", 3, 3)])
def test_a_constant_jacobian_is_factored_once_for_each_system(method, jacobians, factors):
    """A real and a complex system of Radau's method, one for each stage of the other."""
    a = np.array([[-100.0, 1.0], [0.0, -1.0]])
    run = cg.solve_ivp(
        lambda t, y: a @ y, (0, 1), [1.0, 1.0], frame=Euclidean(2), method=method, h=0.125
    )
    assert (run.steps, run.njev, run.nlu) == (8, jacobians, factors)


class TestLikeScipy:
    @pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
    def test_counts_on_a_vector_space(self, tolerance):
        calls = []

        def counted(t, y):
            calls.append(t)
            return van_der_pol(t, y)

        other = solve_ivp(counted, (0, 200), START, method="Radau", rtol=tolerance, atol=tolerance)
        evaluations = len(calls)
        run = solve(rtol=tolerance, atol=tolerance)
        assert run.nfev <= 1.3 * evaluations
        assert run.nlu <= 1.3 * other.nlu
        assert run.njev <= 1.3 * other.njev
        exact = solve(rtol=1e-11, atol=1e-11).y[-1]
        here, there = (np.abs(y - exact).max() for y in (run.y[-1], other.y[:, -1]))
        assert here <= 10 * there + 1e-10

    def test_stages_of_a_linear_equation_take_one_correction(self):
        """With matrices of size 12 whose factors need pivots."""
        rng = np.random.default_rng(3)
        basis = rng.standard_normal((12, 12))
        matrix = basis @ np.diag(-(10.0 ** np.linspace(0, 4, 12))) @ np.linalg.inv(basis)
        y0 = rng.standard_normal(12)
        run = solve(lambda t, y: matrix @ y, 1.0, y0, Euclidean(12), jac=lambda t, y: matrix)
        np.testing.assert_allclose(run.y[-1], expm(matrix) @ y0, rtol=0, atol=1e-7)
        assert run.njev == 1
        assert run.nfev <= 7.5 * (run.steps + run.nrejected)


class TestLoop:
    def test_sizes_settle_where_the_angle_limits_them(self):
        f = lambda t, y: [10.0 + 0.01 * np.sin(t), 0.01 * np.cos(t), 3.0]
        run = solve(f, 200.0, np.eye(3), SO3(), rtol=1e-3, atol=1e-3)
        assert run.nrejected < 0.01 * run.steps

    def test_steps_without_a_solution(self):
        options = {"frame": Euclidean(1), "method": "RadauIIA5"}
        with pytest.raises(cg.ConvergenceError, match="did not converge"):
            cg.integrate(lambda t, y: 1.0 + y**2, (0, 4), [0.0], h=4.0, **options)
        run = cg.solve_ivp(lambda t, y: 1.0 + y**2, (0, 4), [0.0], **options)
        assert not run.success
        assert run.t[-1] == pytest.approx(np.pi / 2, abs=1e-3)

    def test_singular_matrices(self):
        """Factors don't exist for the first step size; adaptive steps are then smaller."""
        gamma = float(transformation(RADAU)[-3])
        options = {"frame": Euclidean(1), "method": RADAU, "jac": lambda t, y: [[8.0 * gamma]]}
        with pytest.raises(cg.ConvergenceError, match="did not converge"):
            cg.integrate(lambda t, y: -y, (0, 1), [1.0], h=0.125, **options)
        run = cg.solve_ivp(lambda t, y: -y, (0, 1), [1.0], first_step=0.125, **options)
        assert run.nrejected > 0
        assert run.y[-1, 0] == pytest.approx(np.exp(-1.0), rel=1e-3)

    def test_jacobians_that_overflow(self):
        f = lambda t, y: 1e305 * np.tanh(1e8 * (y - 1.0))
        options = {"frame": Euclidean(1), "method": RADAU}
        with pytest.raises(cg.ConvergenceError, match="did not converge"):
            cg.integrate(f, (0, 1), [1.0], h=0.125, **options)
        with pytest.warns(UserWarning, match="steps were rejected"):
            run = cg.solve_ivp(f, (0, 1), [1.0], **options)
        assert "step size fell below" in run.message


def test_other_implicit_tableaux_are_refused():
    rows = [["1/4", "-0.0386751345948128823"], ["0.538675134594812882", "1/4"]]
    refuses(cg.MethodError, "tableau must", cg.MuntheKaas, cg.Tableau(rows, ["1/2", "1/2"]))


@pytest.mark.parametrize("method", ["auto", "RKMK5(4)", "BS3(2)"])
@pytest.mark.parametrize("rtol", [1e-3, 1e-8])
def test_stiff(method, rtol):
    run = solve(method=method, rtol=rtol, max_steps=500, t1=2000.0)
    assert not run.success
    assert "stiff" in run.message
    assert "RadauIIA5" in run.message


def test_warning_while_it_runs():
    with pytest.warns(UserWarning, match="many steps, since .* stiff.*RadauIIA5") as caught:
        run = solve(method="auto", max_steps=12_000, t1=2000.0)
    assert len(caught) == 1
    assert run.steps + run.nrejected == 12_000


@pytest.mark.parametrize("rtol", [1e-3, 1e-8])
def test_no_warning_if_it_is_not_stiff(rtol, recwarn):
    run = solve(pendulum, 1e5, method="auto", rtol=rtol, max_steps=12_000)
    assert run.steps + run.nrejected == 12_000
    assert not recwarn


@pytest.mark.parametrize(("method", "force"), [("auto", 0.5), ("auto", 0.2), (RADAU, 0.5)])
def test_a_discontinuity_that_the_solution_stays_at(method, force):
    friction = lambda t, y: [y[1], force * np.sin(t) - np.sign(y[1])]
    with pytest.warns(UserWarning, match="many steps, since many are rejected"):
        run = solve(friction, 20.0, [0.0, 1.0], method=method, max_steps=12_000)
    assert "many are rejected, as where f jumps" in run.message
    assert ("RadauIIA5" in run.message) == (method == "auto")
    assert "event" in run.message
    assert "stiff" not in run.message


@pytest.mark.parametrize("jac", [jacobian, sparse_jacobian])
def test_given(jac):
    run, other = solve(jac=jac), solve()
    np.testing.assert_allclose(run.y[-1], other.y[-1], rtol=5e-8)
    assert run.nfev < other.nfev


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize(("rtol", "atol"), [(1e-3, 1e-6), (1e-6, 1e-6), (1e-6, 1e-10)])
def test_differences_of_small_coordinates(unit, rtol, atol):
    """Of Robertson's reaction, in which 1e-13 of a substance remains."""

    def f(t, y):
        slow, fast, slowest = 0.04 * y[0], 1e4 / unit * y[1] * y[2], 3e7 / unit * y[1] ** 2
        return [fast - slow, slow - fast - slowest, slowest]

    def jac(t, y):
        fast, slowest = 1e4 / unit * y[1:][::-1], 6e7 / unit * y[1]
        return [[-0.04, *fast], [0.04, -fast[0] - slowest, -fast[1]], [0.0, slowest, 0.0]]

    options = {"frame": Euclidean(3), "rtol": rtol, "atol": atol * unit}
    run, other = (solve(f, 1e11, [unit, 0.0, 0.0], jac=j, **options) for j in (None, jac))
    assert (run.success, run.steps) == (True, pytest.approx(other.steps, rel=0.05))
    reference = np.array([2.08334015e-08, 8.33336077e-14, 0.9999999791666])
    assert (np.abs(run.y[-1] / unit - reference) < max(100 * atol * rtol, atol)).all()


def test_differences_where_a_coordinate_vanishes():
    def f(t, y):
        return [-1e3 * y[0], 1e3 * y[0] - 1e6 * (y[1] - np.cos(t)) * (1 + y[1] ** 2), y[1] - y[2]]

    options = {"frame": Euclidean(3), "method": "RadauIIA5", "rtol": 1e-6, "atol": 1e-9}
    run = cg.solve_variational(f, (0, 2), [1.0, 0.0, 0.0], **options)
    np.testing.assert_allclose(run.transition[-1, 2, 2], np.exp(-2.0), rtol=1e-7)


@pytest.mark.parametrize("kind", [np.array, sparse.csc_array])
@pytest.mark.parametrize("frame", [SO3(), SO3("space"), Sphere(2)], ids=repr)
@pytest.mark.parametrize(("rate", "spin"), [(1e4, 0.0), (1.0, 30.0)])
def test_brackets_are_added(frame, kind, rate, spin):
    """With exact Jacobians Newton's method takes as many iterations as with differences.

    In a fast rotation brackets are most of the Jacobian.
    """
    fast = rate * np.array([[1.0, 0.2, 0.0], [-0.3, 2.0, 0.1], [0.0, 0.4, 3.0]])
    y0 = np.eye(3) if frame.point_shape == (3, 3) else np.array([0.0, 0.6, 0.8])

    def f(t, y):
        first = y.reshape(-1, 3)[0]
        return fast @ np.cross(first, [np.cos(t), np.sin(t), 0.0]) + spin * np.ones(3)

    def jac(t, y):
        h = 1e-6
        ends = [[f(t, frame.flow(s * v, y)) for v in np.eye(3)] for s in (h, -h)]
        return kind((np.array(ends[0]) - np.array(ends[1])).T / (2.0 * h))

    run, other = solve(f, 0.5, y0, frame, jac=jac), solve(f, 0.5, y0, frame)
    np.testing.assert_allclose(run.y[-1], other.y[-1], rtol=0, atol=2e-11)
    assert run.nfev + 3 * run.njev == pytest.approx(other.nfev, rel=0.02)


@pytest.mark.parametrize(("jac", "error", "message"), [
    (3, TypeError, r"jac must be callable as jac\(t, y\), got 3"),
    (lambda t, y: [[1.0]], ValueError, r"jac must return .*\(2, 2\), got shape \(1, 1\)"),
    (lambda t, y: sparse.eye_array(3), ValueError, r"jac must return .*\(2, 2\)"),
    (lambda t, y: np.full((2, 2), np.nan), ValueError, "jac must return finite numbers"),
    (lambda t, y: jacobian(t, y) * (1.0 if t < 1 else np.nan), ValueError, "finite"),
    (lambda t, y: sparse_jacobian(t, y) * (1.0 if t < 1 else np.inf), ValueError, "finite"),
    (lambda t, y: (1j if t > 1 else 1) * sparse_jacobian(t, y), ValueError, "real numbers"),
    (lambda t, y: jacobian(t, y) / (0 if t > 1 else 1.0) // 0, ValueError, "finite"),
    (lambda t: jacobian(t, 0), TypeError, "but 2 were given\njac is given the arguments of f"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_bad_values(jac, error, message):
    refuses(error, message, solve, jac=jac)
    refuses(
        ValueError, "method must be .RadauIIA5. with jac but without derivatives, got .*DP5|RKMK8",
        solve, method="auto", jac=jacobian,
    )  # fmt: skip


@pytest.mark.parametrize("at", [0.0, 1.0])
def test_exceptions_pass_through(at):
    def jac(t, y):
        if t >= at:
            raise KeyError("mine")
        return jacobian(t, y)

    refuses(KeyError, "mine", solve, jac=jac)
