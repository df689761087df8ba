"""Warnings about steps: equal ones that are far too long, and kinks without breakpoints."""

import warnings

import numpy as np
import pytest

import cg
from cg.frames import SE3, SO3, SU, Euclidean, Product, Sphere, UnitQuaternion

FRAMES = [SO3(), UnitQuaternion(), SE3(), Sphere(2), SU(3), Product(Euclidean(2), SO3("space"))]
MESSAGE = "h = 50 is far too long a step: between the stages of the last step h f changes by"


def wild(dim, size=3.0):
    """Return a function whose coefficients change fast, and the list of its calls."""
    frequencies, calls = np.arange(1.0, 1.0 + dim), []

    def f(t, y):
        calls.append(t)
        return size * np.cos(frequencies * (t + np.abs(y).sum()))

    return f, calls


def integrate(f, frame, method="CF4", h=50.0):
    y0 = frame.random_point(np.random.default_rng(1))
    return cg.integrate(f, (0, 2 * h), y0, frame=frame, method=method, h=h)


@pytest.mark.parametrize("method", ["CF4", "CG4a", "CF5(4)", "DP5(4)"])
def test_methods(method):
    f, calls = wild(3)
    with pytest.warns(UserWarning, match=MESSAGE):
        run = integrate(f, SO3(), method)
    assert run.success
    assert len(calls) == run.nfev
    with pytest.raises(cg.StepTooLongError):
        integrate(f, SO3(), "RKMK4")
    integrate(f, SO3(), method, h=0.05)  # without a warning, which would be an error


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_frames(frame):
    f, _ = wild(frame.dim)
    with pytest.warns(UserWarning, match=MESSAGE):
        integrate(f, frame)
    integrate(f, frame, h=0.02)


def test_the_caller_is_named():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cg.integrate(wild(3)[0], (0, 100), np.eye(3), frame=SO3(), method="CF4", h=50)
        cg.solve_ivp(wild(3)[0], (0, 100), np.eye(3), frame=SO3(), method="CF4", h=50)
    assert [warning.filename for warning in caught] == [__file__, __file__]


@pytest.mark.parametrize("method", ["CF5(4)", "RKMK5(4)", "CG5(4)"])
def test_adaptive_steps_turn_far_while_coefficients_change_by_less_than_the_tolerance(method):
    """A change of one of three coefficients is the root of three times as large as its norm."""
    for change, steps in ((1.6e-6, 1), (1.9e-6, 3)):
        run = cg.solve_ivp(
            lambda t, y, c=change: [0.0, 0.0, 1e3 + c * t], (0, 1), np.eye(3), frame=SO3(),
            method=method, rtol=1e-12, atol=1e-6, first_step=1.0,
        )  # fmt: skip
        assert run.steps == steps


def test_kinks_without_breakpoints():
    """The data are interpolated linearly."""
    times = np.linspace(0.0, 1.0, 301)
    rates = np.random.default_rng(1).standard_normal((3, len(times)))

    f = lambda t, y: [np.interp(t, times, row) for row in rates]
    options = {"frame": SO3(), "method": "RKMK8(5,3)", "rtol": 1e-11, "atol": 1e-11}
    with pytest.warns(UserWarning, match="name them as breakpoints") as caught:
        poor = cg.solve_ivp(f, (0, 1), np.eye(3), **options)
    assert caught[0].filename == __file__
    good = cg.solve_ivp(f, (0, 1), np.eye(3), breakpoints=times, **options)
    assert good.nrejected == 0
    assert good.nfev < 0.5 * poor.nfev
    assert np.isin(times, good.t).all()
