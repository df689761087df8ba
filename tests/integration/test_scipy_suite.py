"""SciPy's own tests of `solve_ivp`, run with this package's, and with the solvers for SciPy's."""

import re
import types
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from refusals import refuses
from scipy import integrate
from scipy.optimize import OptimizeResult

import cg
import cg.scipy
from cg.frames import Euclidean, Product, UnitQuaternion

suite = pytest.importorskip("scipy.integrate._ivp.tests.test_ivp")

METHODS = {"RK23": "BS3(2)", "RK45": "DP5(4)", "DOP853": "DOP853"}
NAMES = ["t", "sol", "t_events", "y_events", "nfev", "njev", "nlu", "status", "message", "success"]
WORDS = {
    r"events\[0\].terminal must be a bool or a whole number": "The `terminal` attribute...",
    "args must be a tuple of further arguments": "Supplied 'args' cannot be unpacked.",
    "y0 must be finite": "All components of the initial state `y0` must be finite.",
    "A terminal event ended the integration.": "A termination event occurred.",
}
"""Messages, and SciPy's."""


def translated(text):
    """SciPy's words for one of our messages, or the message."""
    return next((theirs for ours, theirs in WORDS.items() if re.match(ours, text)), text)


def solve_ivp(fun, t_span, y0, method="RK45", vectorized=False, jac=None, **options):
    """Solve on Euclidean space; complex numbers are pairs of real ones, time is the last axis.

    Evaluations for output between steps aren't counted, and ``sol`` goes on after the end, as
    SciPy's does.
    """
    y0 = np.asarray(y0)
    y0 = y0 if y0.dtype.kind == "c" else y0.astype(float)
    name = METHODS.get(method if isinstance(method, str) else method.__name__, "RadauIIA5")
    options.pop("jac_sparsity", None)

    def f(t, y, *args):
        y = y.view(y0.dtype)
        value = fun(t, y[:, None], *args)[:, 0] if vectorized else fun(t, y, *args)
        return np.asarray(value, dtype=y0.dtype).view(float)

    if jac is not None and name == "RadauIIA5":
        options["jac"] = jac
    start = y0.view(float)
    solve = partial(cg.solve_ivp, f, frame=cg.frames.Euclidean(start.size), method=name, **options)
    try:
        solution = solve(t_span, start)
    except (TypeError, ValueError) as error:
        raise type(error)(translated(str(error))) from error
    result = OptimizeResult({name: getattr(solution, name) for name in NAMES})
    result.message = translated(result.message)
    result.y = solution.y.view(y0.dtype).T
    if not solution.t.size:
        result.t = result.y = []
    if method == "LSODA":  # which doesn't count them
        result.njev = result.nlu = 0
    if solution.y_events is not None:
        result.y_events = [y if len(y) else np.empty(0) for y in solution.y_events]
    if (sol := solution.sol) is not None:

        def at(t):
            if t <= sol.t_max or sol.t_min == sol.t_max:
                return sol(min(t, sol.t_max))
            return solve((sol.t_max, t), sol(sol.t_max), events=None, dense_output=False).y[-1]

        def evaluate(t):
            points = np.array([at(time) for time in np.ravel(t)])
            return points.view(y0.dtype).T.reshape(-1, *np.shape(t))

        result.sol = evaluate
        result.nfev = solve(t_span, start, dense_output=False, t_eval=None).nfev
    return result


class OfAnySize(cg.scipy.FrameSolver):
    """The solver on Euclidean space of the size of a point; a subclass has a method."""

    def __init__(self, fun, t0, y0, *rest, jac=None, jac_sparsity=None, **options):
        self.frame = cg.frames.Euclidean(np.size(y0))
        super().__init__(fun, t0, y0, *rest, **options)


@pytest.fixture(autouse=True)
def replace_solvers(monkeypatch, request):
    if request.cls is not TestOdeSolver:
        monkeypatch.setattr(suite, "solve_ivp", solve_ivp)
        return
    from scipy.integrate._ivp import ivp

    for name in ivp.METHODS:
        members = {"method": METHODS.get(name, "RadauIIA5")}
        solver = type(name, (OfAnySize,), members)
        monkeypatch.setitem(ivp.METHODS, name, solver)
        monkeypatch.setattr(suite, name, solver)


@pytest.fixture
def num_parallel_threads():
    return 1


# Tests that fail, and why
DIFFERENCES = {
    "test_integration_complex": (AssertionError, "RadauIIA5 takes more evaluations than BDF"),
    "test_empty": (ValueError, "a frame has at least one dimension"),
}
TESTS = {
    name: test
    for name, test in vars(suite).items()
    if name.startswith("test_") and "solve_ivp" in test.__code__.co_names
}
# and those of the class
CLASS_DIFFERENCES = {
    "test_integration": (AssertionError, "interpolants take evaluations"),
    "test_integration_complex": (ValueError, "Euclidean space is real"),
    "test_integration_complex_sparse": (ValueError, "Euclidean space is real"),
    "test_integration_const_jac": (AssertionError, "RadauIIA5 in place of LSODA counts Jacobians"),
    "test_max_step": (RuntimeError, "a step that is too small fails at once"),
    "test_no_integration_class": (ValueError, "a frame has at least one dimension"),
    "test_empty": (ValueError, "a frame has at least one dimension"),
    "test_classes": (AssertionError, "the constructor doesn't call f"),
    "test_inital_maxstep": (AttributeError, "it reads the orders of SciPy's methods"),
}
CLASS_TESTS = {
    name: types.FunctionType(test.__code__, vars(suite), name, test.__defaults__)
    for name, test in vars(suite).items()
    if name.startswith("test_")
}


def collected(tests, differences):
    """Return a class of the tests, in which those that differ must fail."""
    for name, function in tests.items():
        error, reason = differences.get(name, (None, ""))
        marks = getattr(vars(suite)[name], "pytestmark", [])
        function.pytestmark = [mark for mark in marks if mark.name == "parametrize"]
        pytest.mark.xfail(bool(reason), raises=error, reason=reason, strict=True)(function)
        if "sparse_difference" in name:
            pytest.mark.slow(function)
    return type("Collected", (), {name: staticmethod(test) for name, test in tests.items()})


TestSolveIvp = collected(TESTS, DIFFERENCES)
TestOdeSolver = collected(CLASS_TESTS, CLASS_DIFFERENCES)


def test_differences_are_of_tests_that_exist():
    assert set(DIFFERENCES) < set(TESTS)
    newer = {"test_integration_complex_sparse"}  # since SciPy 1.18
    assert set(CLASS_DIFFERENCES) - newer < set(CLASS_TESTS)


FRAME = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
Y0 = np.array([0.0, 0.6, 0.0, 0.8, 1.0, 2.0, -0.5])
SOLVER = cg.scipy.Solver(FRAME)
FINE = {"rtol": 1e-10, "atol": 1e-10}


def body(t, y):
    """Return the derivative of a free rigid body's state, as a list."""
    coefficients = np.concatenate([y[4:], np.cross([1.0, 2.0, 2.5] * y[4:], y[4:]) / [1, 2, 2.5]])
    return FRAME.field(coefficients, y).tolist()


@pytest.mark.parametrize(("rtol", "pair"), [(1e-4, "CF5(4)"), (9e-5, "RKMK8(5,3)")])
def test_default_for_kinks_at_loose_tolerances(rtol, pair):
    from scipy.integrate import solve_ivp as theirs

    runs = [
        theirs(body, (0, 5), Y0, method, rtol=rtol)
        for method in (SOLVER, cg.scipy.Solver(FRAME, pair))
    ]
    np.testing.assert_array_equal(runs[0].y, runs[1].y)


@pytest.mark.parametrize("frame", [
    cg.frames.SO3(), cg.frames.SE3(), cg.frames.SU(2), cg.frames.Stiefel(4, 2), cg.frames.SPD(2),
    cg.frames.Power(cg.frames.Sphere(2), 2), cg.frames.IsospectralOrbit((0.0, 1.0), hermitian=True),
], ids=repr)  # fmt: skip
@pytest.mark.parametrize("vectorized", [False, True])
def test_solutions_in_scipy_are_those_here(frame, vectorized):
    from scipy.integrate import solve_ivp as theirs

    rng = np.random.default_rng(2)
    y0, v = frame.random_point(rng), frame.random_vector(rng)
    f = lambda t, y: frame.field(np.cos(t) * v, y)

    def flat(t, y):
        columns = y.T.reshape(-1, *frame.point_shape)
        return np.stack([f(t, each).ravel() for each in columns], axis=1).reshape(y.shape)

    solver, options = cg.scipy.Solver(frame, "CF5(4)"), {"t_eval": [0.5, 0.1], "rtol": 1e-6}
    here = cg.solve_ivp(f, (1, 0), y0, frame=frame, rhs="derivative", method="CF5(4)", **options)
    run = theirs(flat, (1, 0), y0.ravel(), solver, vectorized=vectorized, **options)
    assert run.success
    np.testing.assert_allclose(run.y.T.reshape(here.y.shape), here.y, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match=r"y0 must be the \d+ entries of a point"):
        solver(flat, 0, np.append(y0.ravel(), 1.0), 1)


def test_hosts_may_move_the_point_and_the_end():
    times, h = np.linspace(0.0, 3.0, 7), 1e-9
    solver = SOLVER(body, 0.0, Y0, 10.0, **FINE)
    for k, end in enumerate(times[1:]):
        solver.t_bound, solver.status = end, "running"
        while solver.status == "running":
            assert solver.step() is None
        assert solver.t == end
        solver.y[4 + k % 3] += 0.1
        output = solver.dense_output()
        assert FRAME.membership_error(output(np.linspace(end - h, end + 0.1, 5)).T).max() < 1e-15
    y = Y0
    for k, span in enumerate(pairwise(times)):
        y = cg.solve_ivp(body, span, y, frame=FRAME, rhs="derivative", **FINE).y[-1].copy()
        y[4 + k % 3] += 0.1
    np.testing.assert_allclose(solver.y, y, rtol=0, atol=1e-9)
    solver.y, solver.t, solver.t_bound, solver.status = Y0, 0.0, 0.5, "running"
    while solver.status == "running":
        solver.step()
    first = cg.solve_ivp(body, (0, 0.5), Y0, frame=FRAME, rhs="derivative", **FINE).y[-1]
    np.testing.assert_allclose(solver.y, first, rtol=0, atol=1e-14)
    solver.y[0], solver.t_bound, solver.status = 7.0, 1.0, "running"
    refuses(ValueError, "y must be a point of", solver.step)


def test_tolerances_of_entries_and_what_is_dropped():
    from scipy.integrate import solve_ivp as theirs

    loose = [1e-2] * 4 + [1e-9] * 3
    by_entries = theirs(body, (0, 2), Y0, SOLVER, rtol=1e-9, atol=loose)
    coordinates = [1e-2] * 3 + [1e-9] * 3
    here = cg.solve_ivp(
        body, (0, 2), Y0, frame=FRAME, rhs="derivative", rtol=1e-9, atol=coordinates
    )
    np.testing.assert_array_equal(by_entries.y.T, here.y)
    pull = lambda t, y: body(t, y) + np.append(y[:4], np.zeros(3))
    with pytest.warns(UserWarning, match="which is dropped") as caught:
        theirs(pull, (0, 2), Y0, SOLVER)
    assert [warning.filename for warning in caught] == [__file__]
    with pytest.warns(UserWarning, match="options without effect: min_step"):
        SOLVER(body, 0, Y0, 1, min_step=0.1)
    with pytest.raises(ValueError, match="atol must be a number or 7 numbers"):
        SOLVER(body, 0, Y0, 1, atol=[1e-3, 1e-3])
    ended = theirs(lambda t, y: np.full(7, np.nan) if t > 1 else body(t, y), (0, 2), Y0, SOLVER)
    assert ended.status == -1
    assert "f must return finite numbers" in ended.message
    refuses(TypeError, r"frame must be a Frame such as .*, got 3", cg.scipy.Solver, 3)
    refuses(ValueError, "method must be the name", cg.scipy.Solver, FRAME, "RK45")
    spin = cg.frames.Product(cg.frames.SU(2), cg.frames.Euclidean(1))
    turn = lambda t, y: spin.field([np.cos(t), y[8], 0.3, -y[8]], y)
    options = {"method": cg.scipy.Solver(spin), "rtol": 1e-9}
    parts = [  # of one number of a factor the smallest counts, be it imaginary
        theirs(turn, (0, 2), spin.join(np.eye(2), [1.0]), atol=atol, **options).t
        for atol in ([1e-9] + [1e-2] * 8, [1e-2, 1e-9] + [1e-2] * 7)
    ]
    np.testing.assert_array_equal(*parts)


@pytest.mark.parametrize("wrap", [lambda s: s, lambda s: cg.frames.Power(s, 2)])
def test_the_default_is_that_for_derivatives(wrap):
    """`Stiefel` has brackets, but moves along derivatives without them."""
    frame = wrap(cg.frames.Stiefel(3, 2))
    y0 = frame.random_point(np.random.default_rng(0))
    w = np.array([[0, 1, 2], [-1, 0, 1], [-2, -1, 0]])
    f = lambda t, y: (w @ y.reshape(frame.point_shape)).ravel()
    options = {"rtol": 1e-8, "atol": 1e-8}
    run = integrate.solve_ivp(f, (0, 1), y0.ravel(), cg.scipy.Solver(frame), **options)
    ours = cg.solve_ivp(lambda t, y: w @ y, (0, 1), y0, frame=frame, rhs="derivative", **options)
    np.testing.assert_allclose(run.y[:, -1], ours.y[-1].ravel(), rtol=0, atol=1e-14)


def test_large_translations_limit_no_step():
    frame = cg.frames.Semidirect(cg.frames.SO3(), 2)
    v = [0.01, 0.02, 0.03] + [1e3] * 6
    f = lambda t, y: frame.field(v, y.reshape(5, 5)).ravel()
    run = integrate.solve_ivp(f, (0, 10), np.eye(5).ravel(), cg.scipy.Solver(frame))
    assert len(run.t) < 20


def test_wrong_sizes_are_named():
    with pytest.raises(ValueError, match=r"fun must return 7 numbers, got shape \(3,\)"):
        integrate.solve_ivp(lambda t, y: y[:3], (0, 1), Y0, SOLVER)
    for name, value, message in (
        ("y", [1.0, 2.0], r"y must be 7 numbers, got shape \(2,\)"),
        ("t_bound", -1.0, "t_bound must not lie before t = "),
    ):
        solver = SOLVER(lambda t, y: 0 * y, 0.0, Y0, 1.0)
        solver.step()
        setattr(solver, name, value)
        refuses(ValueError, message, solver.step)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
@pytest.mark.parametrize("span", [(0.0, 60.0), (60.0, 0.0)])
def test_events_of_the_host_are_not_stepped_over(span, tolerance):
    """The angle t + t²/200 of a rotation that alone would allow steps of many turns."""
    body = cg.frames.Product(cg.frames.Euclidean(2), cg.frames.UnitQuaternion())

    def f(t, y):
        x, y_, z, w = y[2:]
        return np.array([0.0, 1.0, y_, -x, w, -z]) * np.append([1, 1], [0.5 + 0.005 * t] * 4)

    def east(t, y):
        return 1.0 - 2.0 * (y[3] ** 2 + y[4] ** 2)

    angles = np.pi * (np.arange(25) + 0.5)
    times = 100.0 * (np.sqrt(1.0 + angles / 50.0) - 1.0)
    shift = 0.0 if span[0] == 0.0 else 60.0 + 18.0
    half = 0.5 * shift
    options = {"events": east, "rtol": tolerance, "atol": tolerance}
    options |= {"method": cg.scipy.Solver(body)}
    y0 = [0.0, 0.0, 0.0, 0.0, np.sin(half), np.cos(half)]
    run = integrate.solve_ivp(f, span, y0, **options)
    found = np.sort(run.t_events[0])
    np.testing.assert_allclose(found, times, rtol=0, atol=4e-13)
    east.terminal = 3
    run = integrate.solve_ivp(f, span, y0, **options)
    expected = times[2] if span[0] == 0.0 else times[-3]
    assert abs(run.t[-1] - expected) < 4e-13
    for name in ("max_angle", "first_step"):
        for wrong in (0.0, "1", np.nan):
            with pytest.raises((TypeError, ValueError), match=f"{name} must be .*, got {wrong!r}"):
                integrate.solve_ivp(f, span, y0, **options | {name: wrong})


@pytest.mark.filterwarnings("ignore:options without effect:UserWarning")
def test_a_flight_of_rocketpy_keeps_the_norm_of_its_quaternion(monkeypatch):
    rocketpy = pytest.importorskip("rocketpy")
    frame = Product(Euclidean(6), UnitQuaternion(scalar_first=True), Euclidean(3))
    solvers = rocketpy.simulation.flight.ODE_SOLVER_MAP
    monkeypatch.setitem(solvers, "cg", cg.scipy.Solver(frame))
    motor = rocketpy.GenericMotor(
        thrust_source=[[0, 2000], [0.1, 2200], [2.9, 1500], [3, 0]], burn_time=3.0,
        chamber_radius=0.033, chamber_height=0.5, chamber_position=0.3, nozzle_radius=0.033,
        propellant_initial_mass=2.8, dry_mass=1.8, dry_inertia=(0.125, 0.125, 0.002),
        center_of_dry_mass_position=0.3,
    )  # fmt: skip
    rocket = rocketpy.Rocket(0.0635, 14.4, (6.3, 6.3, 0.034), 0.5, 0.5, 0)
    rocket.add_motor(motor, position=-1.25)
    rocket.add_nose(length=0.56, kind="vonKarman", position=1.28)
    rocket.add_trapezoidal_fins(4, 0.12, 0.06, 0.11, position=-1.05, cant_angle=0.5)
    place = rocketpy.Environment(latitude=33, longitude=-107, elevation=1400)
    apogee, off = {}, {}
    for name in ("LSODA", "cg"):
        flight = rocketpy.Flight(
            rocket, place, 5.2, inclination=85, terminate_on_apogee=True, ode_solver=name
        )
        apogee[name] = flight.apogee
        norms = np.linalg.norm(np.array(flight.solution)[:, 7:11], axis=1)
        off[name] = np.abs(norms - 1).max()
    assert off["cg"] < 1e-15 < 1e-5 < off["LSODA"]
    assert apogee["cg"] == pytest.approx(apogee["LSODA"], abs=0.1)
