"""Linear equations: orders on manifolds, steps, output, input."""

import subprocess

import numpy as np
import pytest
from kinds import MAGNUS
from refusals import refuses

import cg
from cg.frames import SE3, SO, SO3, SU, Euclidean, LinearAction, Product, Sphere, UnitQuaternion

FRAMES = [SO3(), SO3("space"), UnitQuaternion(), SE3(), SO(4), SU(2), Sphere(2),
          Product(SO3(), Euclidean(2))]  # fmt: skip


def coefficients_for(frame):
    amplitudes = np.random.default_rng(7).uniform(-1, 1, (2, frame.dim))

    def a(t):
        return amplitudes[0] + amplitudes[1] * np.sin((1.5 + np.arange(frame.dim) / 4) * t)

    return a


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
@pytest.mark.parametrize("name", list(MAGNUS))
def test_orders_on_manifolds(frame, name):
    a = coefficients_for(frame)
    y0 = frame.random_point(np.random.default_rng(2))
    reference = cg.solve_linear(a, (0, 2), y0, frame=frame, method="CFM8(4)", h=2 / 128).y[-1]
    counts = {"CFM4": (16, 32), "CFM6(4)": (8, 16), "CFM6(4)b": (12, 24)}.get(name, (4, 8))
    errors = [
        np.abs(
            cg.solve_linear(a, (0, 2), y0, frame=frame, method=name, h=2 / n).y[-1] - reference
        ).max()
        for n in counts
    ]
    slope = np.log2(errors[0] / errors[1])
    assert cg.methods[name].order - 0.4 < slope < cg.methods[name].order + 1.2


def two_levels():
    return SU(2), lambda t: [np.cos(4 * t), 0.0, 4.0], np.eye(2), 10.0


def rotation():
    return UnitQuaternion(), lambda t: [np.sin(t), np.cos(2 * t), 1.0], [0.0, 0.0, 0.0, 1.0], 10.0


def damped():
    """A driven two-level system whose lower level decays."""
    generators = [-1j * np.diag([1.0, -1.0 - 0.1j]), -1j * np.array([[0, 1], [1, 0]])]
    return LinearAction(generators), lambda t: [1.0, np.cos(2 * t)], [1.0 + 0j, 0.0], 10.0


PROBLEMS = {make.__name__: make for make in (two_levels, rotation, damped)}


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("name", ["CFM6(4)", "CFM6(4)b", "CFM8(4)", "Magnus8(4)"])
def test_errors_are_near_the_tolerances(problem, name):
    frame, a, y0, end = PROBLEMS[problem]()
    exact = cg.solve_linear(a, (0, end), y0, frame=frame, method="CFM8(4)", h=end / 800).y[-1]
    quotients = []
    for tolerance in (1e-5, 1e-7, 1e-9, 1e-11):
        run = cg.solve_linear(
            a, (0, end), y0, frame=frame, method=name, rtol=tolerance, atol=tolerance
        )
        quotients.append(np.linalg.norm(run.y[-1] - exact) / tolerance)
    assert max(quotients) < 50
    # flows along polynomials through Gauss's nodes have an order that their estimates don't see
    least = 0.02 if isinstance(frame, LinearAction) else 0.05
    assert least < np.exp(np.mean(np.log(quotients))) < 20


def test_an_unused_third_result_is_no_estimate():
    # where all fields commute all results agree, and the step grows to its limit
    run = cg.solve_linear(lambda t: [0.0, 0.0, t], (0, 2), np.eye(3), frame=SO3(), rtol=1e-10)
    assert run.nrejected == 0
    np.testing.assert_allclose(run.y[-1], SO3().flow([0, 0, 2.0], np.eye(3)), rtol=0, atol=1e-14)


@pytest.mark.parametrize("node", ["1/2", "1/3", "1"])
def test_a_single_node_that_is_not_at_the_start(node):
    method = cg.MagnusMethod([node], [[1]])
    a = coefficients_for(SO3())
    exact = cg.solve_linear(a, (0, 1), np.eye(3), frame=SO3(), rtol=1e-11, atol=1e-11).y[-1]
    errors = [
        np.abs(
            cg.solve_linear(a, (0, 1), np.eye(3), frame=SO3(), method=method, h=h).y[-1] - exact
        ).max()
        for h in (1 / 40, 1 / 80)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.1)


class TestStagesWithoutPoints:
    """Points of stages are not computed for coefficients that depend on time alone."""

    @pytest.mark.parametrize("vectorized", [False, True])
    def test_munthe_kaas_methods_take_one_flow_per_step(self, vectorized):
        def a(t):
            return np.stack([np.sin(3 * t), np.cos(t), t], axis=-1)

        run = cg.solve_linear(
            a, (0, 2), np.eye(3), frame=SO3(), method="RKMK8(5,3)", h=0.1, vectorized=vectorized
        )
        assert (run.steps, run.nexp) == (20, 20)

    def test_a_step_that_is_too_long_is_reduced(self):
        def a(t):
            return np.stack([0 * t, 0 * t, 1.0 + 300.0 * (t > 1)], axis=-1)

        run = cg.solve_linear(
            a, (0, 2), np.eye(3), frame=SO3(), method="RKMK8(5,3)", vectorized=True, max_step=0.5,
            rtol=1e-6, atol=1e-6,
        )  # fmt: skip
        assert run.success
        assert run.nrejected > 0
        angle = np.arctan2(run.y[-1][1, 0], run.y[-1][0, 0])
        assert np.cos(angle - 302) == pytest.approx(1, abs=1e-11)


class Qobj:
    """Not convertible to an array."""


def test_objects_of_qutip_are_named():
    refuses(ValueError, r"full\(\)", SU(2).vee, Qobj())


@pytest.mark.parametrize(("change", "error", "message"), [
    ({"f": lambda t, y: [1.0, 0.0, 0.0]}, TypeError, r"f is given \(t\)$"),
    ({"args": (1.0,)}, TypeError, r"f is given \(t, args\[0\]\)$"),
    ({"vectorized": 1}, TypeError, "vectorized"),
    ({"method": "CFM5"}, ValueError, "CFM5"),
    ({"f": lambda t: [1.0]}, ValueError, r"^f must return an array of shape \(3,\), got shape"),
    ({"f": lambda t: np.eye(3)}, ValueError, r"got shape \(3, 3\) at t = 0; vee of SO3\(\) makes"),
    ({"f": lambda t: [1j, 0, 0]}, ValueError, "^f must return 3 real numbers"),
    (
        {"f": lambda t: Qobj()},
        ValueError,
        r"^f must return 3 real numbers.*of a Qobj.*full\(\)",
    ),
    ({"f": lambda t: [np.nan] * 3}, ValueError, "^f must return finite numbers, got .*nan"),
])  # fmt: skip
def test_bad_input_is_refused(change, error, message):
    call = {"f": lambda t: [1.0, 0.0, 0.0], "h": 0.5} | change
    f = call.pop("f")
    refuses(error, message, cg.solve_linear, f, (0, 1), np.eye(3), frame=SO3(), **call)


@pytest.mark.parametrize("call", [
    lambda method: cg.solve_ivp(
        lambda t, y: [1.0, 0.0, 0.0], (0, 1), np.eye(3), frame=SO3(), method=method, h=0.5
    ),
    cg.diagnose,
    lambda method: cg.export(method, "c"),
])  # fmt: skip
def test_only_linear_equations_take_these_methods(call):
    refuses((TypeError, ValueError), "method", call, cg.methods["CFM4"])


FIELD = "int field(double t, const double *y, double *f, void *data) { (void) data; %s return 0; }"


@pytest.mark.parametrize("reads", [False, True])
def test_a_compiled_function_that_reads_its_point_is_refused(tmp_path, reads):
    source, library = tmp_path / "field.c", tmp_path / "field.so"
    source.write_text(FIELD % f"f[0] = t; f[1] = 1.0; f[2] = {'y[0]' if reads else '2.0 * t'};")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source], check=True)
    a = cg.CompiledFunction(library, "field")

    def solve():
        return cg.solve_linear(a, (0, 1), np.eye(3), frame=SO3(), rtol=1e-9, atol=1e-9)

    if reads:
        refuses(ValueError, "^f must", solve)
        return
    same = cg.solve_linear(lambda t: [t, 1.0, 2 * t], (0, 1), np.eye(3), frame=SO3(), rtol=1e-9,
                           atol=1e-9)  # fmt: skip
    np.testing.assert_array_equal(solve().y, same.y)
    kaas = cg.solve_linear(a, (0, 1), np.eye(3), frame=SO3(), method="RKMK5(4)", h=0.1)
    assert kaas.nexp == kaas.steps  # points of stages are not computed


@pytest.mark.parametrize("method", ["auto", "Magnus8(4)", "CFM8(4)"])
def test_first_steps_resolve_fast_coefficients(method):
    """A small coefficient lets the first step span many periods, which its nodes don't resolve."""
    frame, axis = SO3(), np.array([1.0, 0.5, -0.5])
    for w, size, phase, tolerance in (
        (210.0, 0.026, 4.0, 1e-7), (84.5, 0.1, 6.0, 1e-4), (170.26, 0.2, 3.5, 1e-7)
    ):  # fmt: skip
        run = cg.solve_linear(
            lambda t, w=w, size=size, phase=phase: size * np.cos(w * t + phase) * axis, (0, 1),
            np.eye(3), frame=frame, method=method, rtol=tolerance, atol=tolerance,
        )  # fmt: skip
        turned = size * (np.sin(w + phase) - np.sin(phase)) / w
        assert np.abs(run.y[-1] - frame.flow(turned * axis, np.eye(3))).max() < tolerance / 20


def test_first_steps_along_polynomials_resolve_fast_coefficients():
    frame = cg.frames.LinearAction([np.array([[-1j]])])
    run = cg.solve_linear(
        lambda t: [0.1516 * np.cos(63.24 * t + 3.5367)], (0, 1), [1.0 + 0j], frame=frame,
        rtol=1e-4, atol=1e-4,
    )  # fmt: skip
    turned = 0.1516 * (np.sin(63.24 + 3.5367) - np.sin(3.5367)) / 63.24
    assert abs(run.y[-1, 0] - np.exp(-1j * turned)) < 2e-5
