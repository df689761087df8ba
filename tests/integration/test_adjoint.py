"""Gradients by the adjoint equation against derivatives forward in time."""

import numpy as np
import pytest
from quotients import derivative
from refusals import refuses
from waves import TIGHT

import cg
from cg.frames import SE3, SO3, Euclidean, LinearAction, Product, Sphere, Stiefel


def test_a_stiff_equation_is_refused_before_it_takes_long():
    calls = []

    def f(t, y):
        calls.append(t)
        return [-1e8 * (y[0] - np.cos(t))]

    run = cg.solve_variational(
        f, (0, 1), [1.0], frame=Euclidean(1), derivatives="adjoint", method="RadauIIA5"
    )
    before = len(calls)
    with pytest.raises(ValueError, match=r"equation that is this stiff: the integral of .* 1e\+08"):
        run.gradient([1.0])
    assert len(calls) - before < 1000


def test_lengths_far_larger_than_angles_are_not_stiff():
    """A satellite at 7 km/s: the Jacobian has entries of 7e3, but eigenvalues of 0.1."""
    speed = 7e3
    size = np.array([1.0, 1.0, 1.0, speed, speed, speed])

    def f(t, y, p):
        turning = [0.02 * p[0] * np.sin(0.1 * t), 0.01 * np.cos(0.05 * t), 0.05 - 0.01 * y[2, 0]]
        return [*turning, p[0] * speed, 0.0, 0.1 * speed * np.sin(0.03 * t)]

    options = {"frame": SE3(), "parameters": [1.0], "rtol": 1e-8, "atol": 1e-8 * size}
    forward, adjoint = (
        cg.solve_variational(f, (0, 60), np.eye(4), derivatives=kind, **options)
        for kind in ("forward", "adjoint")
    )
    cost = np.array([1.0, 2.0, 3.0, 1.0, -1.0, 2.0]) / size
    gradient = adjoint.gradient(cost)
    np.testing.assert_allclose(
        gradient.y0 * size, (cost @ forward.transition[-1]) * size, rtol=0, atol=2e-6
    )
    np.testing.assert_allclose(gradient.parameters, cost @ forward.sensitivity[-1], rtol=1e-8)


def _at_third(t, y, p):
    return [p[0] * (t > 1 / 3)]


def test_a_jump_without_a_breakpoint_is_refused():
    """Each bisection of the step has the jump at a third or two thirds of an interval."""
    options = {"frame": Euclidean(1), "parameters": [2.0], "derivatives": "adjoint"}
    options |= {"method": "CF4", "h": 1.0}
    run = cg.solve_variational(_at_third, (0, 1), [0.0], **options)
    refuses(ValueError, r"resolved at t = 0\.333333.* name .* breakpoints", run.gradient, [1.0])
    named = cg.solve_variational(_at_third, (0, 1), [0.0], breakpoints=[1 / 3], **options)
    np.testing.assert_allclose(named.gradient([1.0]).parameters, [2 / 3], rtol=5e-11)


def test_intervals_are_not_bisected_beyond_the_resolution_of_time():
    unit = np.spacing(1 / 3)
    run = cg.solve_variational(
        _at_third, (1 / 3 - 20 * unit, 1 / 3 + 21 * unit), [0.0], frame=Euclidean(1),
        parameters=[2.0], derivatives="adjoint", method="CF4", h=1.0,
    )  # fmt: skip
    refuses(ValueError, "aren't resolved", run.gradient, [1.0])


def test_noise_of_a_right_hand_side_is_refused_before_it_takes_long():
    noise = np.random.default_rng(1)
    run = cg.solve_variational(
        lambda t, y, p: p * (1.0 + 1e-3 * noise.standard_normal()), (0, 1), [0.0],
        frame=Euclidean(1), parameters=[2.0], derivatives="adjoint", method="CF4", h=0.1,
    )  # fmt: skip
    refuses(ValueError, "change by .* between neighbouring times", run.gradient, [1.0])


def test_long_steps_are_divided():
    """A steady spin takes one step of 60 radians, in which covectors turn."""
    spin = [3.0, 0.0, 4.0]
    run = cg.solve_variational(
        lambda t, y: spin, (0, 12), np.eye(3), frame=SO3(), derivatives="adjoint",
        rtol=1e-9, atol=1e-9, max_step=np.inf,
    )  # fmt: skip
    expected = SO3().flow(np.multiply(12, spin), np.eye(3)) @ [1.0, 2.0, 3.0]
    gradient = run.gradient([1.0, 2.0, 3.0])
    np.testing.assert_allclose(gradient.y0, expected, rtol=0, atol=2e-10)
    assert gradient.parameters is None


def test_a_pulse_of_constant_pieces_has_the_gradient_of_exponentials():
    from scipy.linalg import expm_frechet

    pieces, x, z = 30, np.array([[0, 1], [1, 0]]), np.diag([1.0, -1.0])
    edges = np.linspace(0, 4, pieces + 1)
    amplitudes = np.random.default_rng(3).standard_normal(pieces)
    target = np.array([0.6, 0.8j])

    def place(t):
        return min(np.searchsorted(edges, t, "right") - 1, pieces - 1)

    run = cg.solve_linear(
        lambda t, p: [1.0, p[place(t)]], (0, 4), [1, 0], derivatives="adjoint",
        frame=LinearAction([-3j * z, -1j * x], unitary=True), parameters=amplitudes,
        df_dp=lambda t, p: np.stack([np.zeros(pieces), np.eye(pieces)[place(t)]]),
        breakpoints=edges[1:-1], rtol=1e-9, atol=1e-9,
    )  # fmt: skip
    h = edges[1]
    moves = [expm_frechet(-1j * h * (3 * z + u * x), -1j * h * x) for u in amplitudes]
    psi = [np.array([1.0 + 0j, 0.0])]
    for move, _ in moves:
        psi.append(move @ psi[-1])
    overlap = np.vdot(target, psi[-1])
    covector, expected = target.conj(), []
    for (move, change), state in zip(moves[::-1], psi[-2::-1], strict=True):
        expected.append(2 * (overlap.conj() * (covector @ change @ state)).real)
        covector = covector @ move
    gradient = run.gradient(2 * target * np.vdot(target, run.y[-1]))
    np.testing.assert_allclose(gradient.parameters, expected[::-1], rtol=0, atol=3e-11)


def never(t, y, *others):
    raise AssertionError("f was called")


NO_BRACKETS = cg.frames.MatrixFrame([np.tri(3), np.tri(3).T])


@pytest.mark.parametrize(("call", "change", "message"), [
    (cg.solve_variational, {"derivatives": "backward"}, "derivatives must .*, got 'backward'"),
    (cg.solve_variational, {"P0": np.eye(3)}, "derivatives must be 'forward' with P0, got 'adj"),
    (cg.solve_variational, {"noise": np.eye(3)}, "derivatives must be 'forward' with noise, got"),
    (cg.solve_variational, {"control_derivatives": True}, "must be .* control_derivatives, got"),
    (cg.solve_variational, {"events": lambda t, y: y[0, 0]}, "events must be None .*, got 1"),
    (cg.solve_linear, {"df_dp": never, "derivatives": None}, "must be .* or 'adjoint' with df"),
    (cg.solve_linear, {"df_dp": never}, "parameters must be given with df_dp"),
    (cg.solve_linear, {"frame": NO_BRACKETS}, "frame must be a LinearAction or know the brac"),
])  # fmt: skip
def test_what_has_no_adjoint_is_refused(call, change, message):
    options = {"frame": SO3(), "derivatives": "adjoint"} | change
    f = never if call is cg.solve_variational else lambda t: np.ones(3)
    y0 = options["frame"].random_point(np.random.default_rng(0))
    refuses(ValueError, message, call, f, (0, 1), y0, **options)


def test_gradients_far_from_the_time_zero_are_as_exact_as_there():
    def last(start):
        run = cg.solve_variational(
            lambda t, y, p: [p[0] * np.sin(5.0 * t + y[0])],
            (start, start + 1.0), [0.3], frame=Euclidean(1), parameters=[8.0], rtol=1e-6, atol=1e-9,
            derivatives="adjoint",
        )  # fmt: skip
        return run.gradient([1.0])

    turns = 2e4 * np.pi
    near, far = last(0.0), last(turns)
    assert abs(far.y0 - near.y0) < 2e-8
    assert abs(far.parameters - near.parameters) < 1e-6


@pytest.mark.parametrize("cotangent", [np.ones(2), np.ones((5, 3)), "x", [np.nan, 0.0, 0.0]])
def test_bad_cotangents_are_refused(cotangent):
    run = cg.solve_variational(
        lambda t, y: [1.0, 0.0, t], (0, 1), np.eye(3), frame=SO3(), derivatives="adjoint",
        t_eval=[0.5, 1.0],
    )  # fmt: skip
    refuses(ValueError, "cotangent must", run.gradient, cotangent)


def test_cotangents_at_nearly_singular_matrices_are_accepted():
    frame = cg.frames.SPD(2)
    y0 = frame.restore(np.array([[0.6, -0.8], [0.8, 0.6]]) @ [[0.6, 0.8], [-8e-16, 6e-16]])
    solution = cg.solve_ivp(
        lambda t, y, p: p * [0.1, 0.2, 0.3, 0.4], (0, 1), y0, frame=frame, parameters=[1.0],
        derivatives="adjoint",
    )  # fmt: skip
    y = solution.y[-1]
    size = [np.trace(frame.field(v, y)) for v in np.eye(4)]
    slope = np.trace(frame.field([0.1, 0.2, 0.3, 0.4], y))
    np.testing.assert_allclose(solution.gradient(size).parameters, slope, rtol=1e-6)


def test_derivatives_by_entries_are_refused_as_cotangents():
    frame = Product(Sphere(2), Stiefel(4, 2))
    y, units = frame.random_point(np.random.default_rng(2)), np.ones(frame.dim)
    f = {"f": lambda t, y: np.cos(np.arange(frame.dim) + t), "t_span": (0, 1), "y0": y}
    run = cg.solve_ivp(**f, frame=frame, derivatives="adjoint")
    along = frame.coefficients(run.y[-1], frame.field(units, run.y[-1]))
    run.gradient(along + 1e-6 * units)
    refuses(ValueError, "cotangent must be derivatives along", run.gradient, along + 0.1)


def test_exceptions_at_nodes_reach_the_caller():
    fails = []

    def f(t, y):
        if fails:
            raise ZeroDivisionError("at a node")
        return [1.0, 0.0, t]

    run = cg.solve_variational(f, (0, 1), np.eye(3), frame=SO3(), derivatives="adjoint")
    fails.append(True)
    refuses(ZeroDivisionError, "at a node", run.gradient, np.ones(3))


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("kind", ["cubic", "averages"])
def test_gradients_of_random_linear_equations_are_accurate(kind, tolerance):
    for seed in range(8):
        rng = np.random.default_rng([seed, 9])
        g = rng.standard_normal((2, 4, 4)) * rng.uniform(0.3, 3.0)
        frame = cg.frames.LinearAction(list(1j * (g + g.mT) if seed % 2 else g))
        curve = cg.Samples(
            np.linspace(-0.1, 2.1, 12 + (kind == "averages")), rng.standard_normal(12), kind
        )
        y0, c = frame.random_point(rng), frame.random_point(rng)
        exact, actual = (
            cg.solve_linear(
                lambda t, u, p: [p[0] * np.cos(t), u], (0, 2), y0, frame=frame, inputs=curve,
                parameters=[1.3], derivatives="adjoint", rtol=rtol, atol=rtol,
            ).gradient(c)
            for rtol in (1e-13, tolerance)
        )  # fmt: skip
        for one, other in zip(actual, exact, strict=True):
            size = max(1.0, np.abs(other).max())
            np.testing.assert_allclose(one, other, rtol=0, atol=50 * tolerance * size)


def test_steps_pass_knots_that_the_tolerance_cannot_see():
    times = np.linspace(0, 2, 201)
    for kind, values in (("cubic", times), ("averages", 0.5 * (times[1:] + times[:-1]))):
        options = {"frame": Euclidean(1), "inputs": cg.Samples(times, np.sin(values), kind)}
        for rtol, few in ((1e-4, True), (1e-11, False)):
            options |= {"rtol": rtol, "atol": rtol}
            run = cg.solve_ivp(lambda t, y, u: [u], (0, 2), [0.0], **options)
            assert (run.steps < 20) == few
            assert few or np.isin(times[2:-2], run.t).all()  # splines have no knots beside ends


@pytest.mark.parametrize("df_dp", [None, lambda t, y, u: [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]])
def test_jacobian_by_pulses_that_vanish(df_dp):
    """All amplitudes are equal, so that the curve has no corners; the frame is in Python."""
    frame, times, y0 = cg.frames.Sp(2), np.linspace(0, 1, 11)[:-1], np.eye(2)
    f = lambda t, y, u: [u[0], 1.0, u[1]]
    options = {"frame": frame, "inputs": cg.Samples(times, np.zeros((10, 2)))} | TIGHT
    run = cg.solve_variational(f, (0, 1), y0, derivatives="adjoint", df_dp=df_dp, **options)
    jacobian = run.jacobian()
    np.testing.assert_allclose(jacobian.y0, np.diag(np.exp([-2.0, 0.0, 2.0])), rtol=0, atol=2e-13)
    assert (jacobian.parameters, jacobian.inputs.shape) == (None, (3, 10, 2))
    for way in np.random.default_rng(1).standard_normal((3, 10, 2)):

        def end(s, way=way):
            given = options | {"inputs": cg.Samples(times, s * way)}
            return frame.local_coordinates(run.y[-1], cg.solve_ivp(f, (0, 1), y0, **given).y[-1])

        actual = np.tensordot(jacobian.inputs, way, 2)
        np.testing.assert_allclose(actual, derivative(end, bound=1e-12), rtol=0, atol=1e-12)


@pytest.mark.parametrize("columns", [None, 2])
def test_jacobian_of_complex_entries(columns):
    rng = np.random.default_rng(6)
    g = rng.standard_normal((2, 3, 3)) + 1j * rng.standard_normal((2, 3, 3))
    frame = cg.frames.LinearAction(list(g), columns=columns)
    times, values, y0 = np.linspace(0, 1, 5), rng.standard_normal(5), frame.random_point(rng)

    def solve(values, p, y0, **others):
        curves = cg.Samples(times, values, "cubic"), cg.Samples([0.0], [p])
        return cg.solve_linear(
            lambda t, u, p: [p[0], sum(u)], (0, 1), y0, frame=frame, inputs=curves, parameters=[p],
            **TIGHT, **others,
        )  # fmt: skip

    jacobian = solve(values, 0.4, y0, derivatives="adjoint").jacobian()
    way, to = rng.standard_normal(5), frame.random_point(rng)
    for by_p, by_y0 in ((1.0, 0.0), (0.0, 1.0)):

        def end(s, by_p=by_p, by_y0=by_y0):
            return solve(values + s * way, 0.4 + s * by_p, y0 + s * by_y0 * to).y[-1]

        actual = by_p * (jacobian.parameters[..., 0] + jacobian.inputs[1][..., 0])
        actual = actual + jacobian.inputs[0] @ way
        actual = actual + by_y0 * np.tensordot(jacobian.y0, to, to.ndim)
        np.testing.assert_allclose(actual, derivative(end, bound=3e-9), rtol=0, atol=3e-9)


@pytest.mark.parametrize("size", [-1e-12, -1e-100, 1e-100])
def test_gradients_by_tiny_and_negative_numbers(size):
    """Steps of differences are relative to the sizes of parameters and of values of samples."""
    part = lambda number: np.sin(number / abs(size))
    f = lambda t, y, u, p: (part(u) + part(p[..., 0]))[..., None] * y
    held = cg.Samples([0.0, 0.5, 0.75], size * np.array([1.0, 2.0, 0.0]))
    options = {"frame": Euclidean(1), "inputs": held, "rtol": 1e-9, "atol": 1e-9}
    phases, lengths = np.sign(size) * np.array([1.0, 2.0, 0.0]), np.array([0.5, 0.25, 0.25])
    end = np.exp(np.sin(phases) @ lengths + np.sin(phases[0]))
    by_parameter = end * np.cos(phases[0])
    given = f, (0, 1), [1.0]
    for vectorized in (False, True):
        run = cg.solve_variational_ensemble(
            *given, parameters=[[size]], vectorized=vectorized, **options
        )
        found = run.sensitivity[-1].item() * abs(size)
        np.testing.assert_allclose(found, by_parameter, rtol=1e-9)
    run = cg.solve_variational(*given, parameters=[size], derivatives="adjoint", **options)
    _, by_parameters, by_values = run.gradient([1.0])
    np.testing.assert_allclose(by_parameters * abs(size), [by_parameter], rtol=2e-9)
    expected = lengths * end * np.cos(phases)
    np.testing.assert_allclose(by_values * abs(size), expected, rtol=2e-9)


@pytest.mark.parametrize("units", [-3, -2, -1, 1])
def test_breakpoints_next_to_times_of_samples_are_passed(units):
    near = 0.5 + units * np.spacing(0.5)
    samples = cg.Samples([0.0, 0.5, 1.0], [1.0, -2.0, 0.0], "hold")
    s = cg.solve_ivp(
        lambda t, y, u, p: p * u * y, (0.0, 1.0), [2.0], frame=cg.frames.Euclidean(1),
        inputs=samples, parameters=[0.7], breakpoints=[near], derivatives="adjoint", rtol=1e-9,
        atol=1e-9,
    )  # fmt: skip
    assert near in s.t
    gradient = s.gradient([1.0])  # of 2 exp(p (u1 + u2) / 2)
    end = 2.0 * np.exp(-0.35)
    np.testing.assert_allclose(gradient.parameters, [-0.5 * end], atol=1e-7)
    np.testing.assert_allclose(gradient.inputs, [0.35 * end, 0.35 * end, 0.0], atol=1e-7)
