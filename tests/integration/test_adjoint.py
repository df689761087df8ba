"""Gradients by the adjoint equation against derivatives forward in time."""

import numpy as np
import pytest
import quotients
from refusals import refuses

import cg
from cg.frames import (
    SE3,
    SO3,
    Euclidean,
    LinearAction,
)
from cg.integration.derivatives import adjoint_equation


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


def test_noise_of_a_right_hand_side_is_refused_before_it_takes_long(monkeypatch):
    monkeypatch.setattr(adjoint_equation, "_LARGEST", 1e3)
    noise = np.random.default_rng(1)
    run = cg.solve_variational(
        lambda t, y, p: p * (1.0 + 1e-3 * noise.standard_normal()), (0, 1), [0.0],
        frame=Euclidean(1), parameters=[2.0], derivatives="adjoint", method="CF4", h=0.1,
    )  # fmt: skip
    refuses(ValueError, r"aren't resolved at .* by intervals of 0\.0", run.gradient, [1.0])


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
    for (move, derivative), state in zip(moves[::-1], psi[-2::-1], strict=True):
        expected.append(2 * (overlap.conj() * (covector @ derivative @ state)).real)
        covector = covector @ move
    gradient = run.gradient(2 * target * np.vdot(target, run.y[-1]))
    np.testing.assert_allclose(gradient.parameters, expected[::-1], rtol=0, atol=3e-11)


def never(t, y, *others):
    raise AssertionError("f was called")


NO_BRACKETS = cg.frames.MatrixFrame([np.tri(3), np.tri(3).T])


@pytest.mark.parametrize(
    ("call", "change", "message"),
    [
        (cg.solve_variational, {"derivatives": "backward"}, "derivatives must .*, got 'backward'"),
        (cg.solve_variational, {"P0": np.eye(3)}, "P0 must not be given with derivatives='adj"),
        (cg.solve_variational, {"noise": np.eye(3)}, "noise must not be given with"),
        (cg.solve_variational, {"control_derivatives": True}, "control_derivatives must not be"),
        (cg.solve_variational, {"events": lambda t, y: y[0, 0]}, "events must be None with"),
        (cg.solve_linear, {"df_dp": never, "derivatives": None}, "df_dp must not be given with"),
        (cg.solve_linear, {"df_dp": never}, "parameters must be given with df_dp"),
        (cg.solve_linear, {"frame": NO_BRACKETS}, "frame must be a LinearAction or know the brac"),
    ],
)
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


def test_exceptions_at_nodes_reach_the_caller():
    fails = []

    def f(t, y):
        if fails:
            raise ZeroDivisionError("at a node")
        return [1.0, 0.0, t]

    run = cg.solve_variational(f, (0, 1), np.eye(3), frame=SO3(), derivatives="adjoint")
    fails.append(True)
    refuses(ZeroDivisionError, "at a node", run.gradient, np.ones(3))


@pytest.mark.parametrize("bound", [1e-5, 1e-7, 1e-9])
def test_references_with_noise_are_refused(bound):
    rng = np.random.default_rng(4)
    rough = lambda s: np.sin(9 * s + 1) + 1e-9 * rng.standard_normal(5)
    if bound > 1e-6:
        assert np.abs(quotients.derivative(rough, bound) - 9 * np.cos(1)).max() < bound
    else:
        with pytest.raises(AssertionError, match="the reference has an error of"):
            quotients.derivative(rough, bound)
