"""Derivatives of solutions against difference quotients and closed forms."""

from functools import partial

import numpy as np
import pytest
from frame_examples import FRAMES, name
from refusals import refuses
from slow_cases import slow
from waves import TIGHT, Wave

import cg
from cg.frames import SO3, Euclidean, Product, Sphere
from cg.frames.facts import facts_of

KNOWN = [frame for frame in FRAMES if facts_of(frame).has_brackets]


# the first frame of each kind; the model's programs have derivatives on many others
FIRST = list({type(frame): frame for frame in reversed(KNOWN)}.values())
OTHERS = [frame for frame in KNOWN if frame not in FIRST]


@pytest.mark.parametrize("frame", [*FIRST, *slow(*OTHERS)], ids=name)
def test_derivatives_keep_ten_times_the_tolerance(frame):
    wave = Wave(frame)
    for f in (lambda t, y, p: 2 * wave.c * (1 + p[0] + p[1]) / np.sqrt(frame.dim), wave.f):
        given = partial(cg.solve_variational, f, (0, 2), wave.y0, frame=frame)
        solve = partial(given, parameters=wave.parameters)
        sharp = solve(rtol=1e-10, atol=1e-10, control_derivatives=True)
        for tolerance in (1e-4, 1e-6):
            loose = solve(rtol=tolerance, atol=tolerance)
            for part in ("transition", "sensitivity"):
                expected, found = getattr(sharp, part)[-1], getattr(loose, part)[-1]
                error = np.abs(found - expected).max() / max(1.0, np.abs(expected).max())
                assert error < 50 * tolerance, (part, tolerance)


@pytest.mark.parametrize("count", [1, 50])
def test_derivatives_hide_no_errors_of_the_solution(count):
    problem = lambda t, y, p: [np.cos(5 * t)], (0, 5), [0.0]
    options = {"frame": Euclidean(1), "first_step": 0.01, "parameters": np.zeros(count)}
    alone, joint = (solve(*problem, **options) for solve in (cg.solve_ivp, cg.solve_variational))
    assert joint.steps >= alone.steps


def test_errors_of_derivatives_choose_steps_if_asked():
    options = {"frame": SO3(), "rtol": 1e-9, "atol": 1e-9}
    loose, sharp = (
        cg.solve_variational(lambda t, y: [0.0, 0.0, 1.0], (0, np.pi), np.eye(3), **options, **more)
        for more in ({}, {"control_derivatives": True})
    )
    assert sharp.steps > loose.steps
    assert np.abs(sharp.transition[-1] - np.diag([-1.0, -1.0, 1.0])).max() < 1e-9


def test_tolerances_of_each_coordinate_are_those_of_its_derivatives():
    wave = Wave(Product(SO3(), Euclidean(2)))
    loose = wave.derivatives(control_derivatives=True, rtol=1e-3, atol=[1e-3] * 5)
    tight = wave.derivatives(control_derivatives=True, rtol=1e-3, atol=[1e-3, 1e-10, *[1e-3] * 3])
    assert tight.steps > loose.steps


def test_on_spheres_tangents_move_and_isotropy_does_not():
    """A spin about itself moves nothing, so that its image is a spin about the end."""
    wave = Wave(Sphere(2))
    derivatives = wave.derivatives()
    start, end = derivatives.y[0], derivatives.y[-1]
    image = derivatives.transition[-1] @ start
    assert np.abs(np.cross(image, end)).max() < 5e-13
    assert np.abs(image).max() > 0.1


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_first_step_beyond_all_numbers_ends():
    """The point at which the curvature is evaluated isn't finite."""
    run = cg.solve_variational(
        lambda t, y: [0.1, 0.2, 0.3], (1e308, 0.5), np.eye(3), frame=SO3(), method="CF4(3)"
    )
    assert not run.success


@pytest.mark.parametrize("vectorized", [False, True])
def test_parameters_of_any_size_are_differenced(vectorized):
    """An inertia of 1e-5 and a mass of 1e20 get steps of their own size; zero gets one of 1."""
    p = np.array([1e-5, 1e20, 0.0])

    def f(t, y, p):
        p = np.moveaxis(p, -1, 0)
        return np.cos(p[0] * 1e5)[..., None] + y * (p[1] / 1e20 + np.sin(p[2]))[..., None]

    solution = cg.solve_variational_ensemble(
        f, (0, 1), [[0.0]], frame=Euclidean(1), parameters=p[None], vectorized=vectorized, **TIGHT
    )
    # y' = cos(p₀ 1e5) + c y, where c = p₁ / 1e20 + sin p₂
    by_rate = np.cos(1.0) * 1.0
    expected = np.array([-np.sin(1.0) * 1e5 * (np.e - 1), 1e-20 * by_rate, by_rate])
    np.testing.assert_allclose(solution.sensitivity[-1, 0, 0], expected, rtol=2e-9)


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("size", [1.0, 1e9])
def test_steps_of_differences_follow_the_size_of_coordinates(size, vectorized):
    """In units in which the point is 1e9 derivatives are as accurate as in units of one."""
    events = [
        lambda t, y: y[0] / size - 1.5,
        cg.Event(lambda t, y: t - 0.75, jump=lambda t, y: y * np.sqrt(y / size)),
    ]
    solution = cg.solve_variational_ensemble(
        lambda t, y: 0.5 * y**2 / size, (0, 1), [[size]], frame=Euclidean(1), events=events,
        vectorized=vectorized, **TIGHT,
    )  # fmt: skip
    # y = 1 / (1 / y₀ - t / 2) in units of the size; before the jump y = 8/5, dy/dy₀ = y²
    np.testing.assert_allclose(solution.t_events[0][0], [2.0 / 3.0], rtol=1e-13)
    np.testing.assert_allclose(solution.dt_events[0][0] * size, [[-2.0]], rtol=4e-10)
    after = 1.6**1.5
    jumped = 1.5 * np.sqrt(1.6) * 1.6**2
    end = 1.0 / (1.0 / after - 0.125)
    np.testing.assert_allclose(
        solution.transition[-1, 0], [[jumped * (end / after) ** 2]], rtol=2e-10
    )


class TestBadInput:
    """Errors name the argument, what it was and what was expected, before f is called."""

    @staticmethod
    def call(**options):
        def never(t, y, *more):
            raise AssertionError("f was called")

        arguments = {"f": never, "t_span": (0, 1), "y0": np.eye(3), "frame": SO3()} | options
        return cg.solve_variational(**arguments)

    @pytest.mark.parametrize("name", ["jac", "df_dp"])
    @pytest.mark.parametrize(("value", "message"), [
        (np.ones((2, 3)), r"{name} must return an array of shape {shape}, got shape \(2, 3\)"),
        ("x", "{name} must return an array of real numbers of shape {shape}, got 'x' at t = 0"),
        (None, "{name} must return an array of real numbers of shape {shape}, got None at t = 0"),
        (np.full((3, 3), np.nan), "{name} must return finite numbers, got"),
        (1j * np.eye(3), "{name} must return an array of real numbers of shape {shape}"),
    ], ids=["shape", "text", "None", "NaN", "complex"])  # fmt: skip
    def test_of_values_of_functions(self, name, value, message):
        arguments = {name: lambda t, y, p: value}
        message = message.format(name=name, shape=r"\(3, 3\)")
        with pytest.raises(ValueError, match=message):
            self.call(f=lambda t, y, p: [0.1, 0.2, 0.3], parameters=np.ones(3), **arguments)

    @pytest.mark.parametrize("name", ["f", "jac", "df_dp"])
    def test_exceptions_of_functions_end_the_call(self, name):
        def fails(t, y, p):
            if t > 0.3:
                raise ZeroDivisionError(name)
            return np.ones(3) if name == "f" else np.eye(3)

        arguments = {"f": lambda t, y, p: np.ones(3), name: fails}
        refuses(ZeroDivisionError, name, self.call, parameters=np.ones(3), rtol=1e-9, **arguments)

    def test_derivatives_beyond_doubles(self):
        solution = cg.solve_variational(
            lambda t, y: [0.0], (0, 1), [0.0], frame=Euclidean(1), method="CG4a", h=0.5,
            jac=lambda t, y: [[1e200]],
        )  # fmt: skip
        assert solution.status == -1
        assert "derivatives of the solution exceed the range" in solution.message
        assert np.isfinite(solution.transition).all()
