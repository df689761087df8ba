"""Breakpoints: steps end there, and each step uses f on its own side."""

import warnings

import numpy as np
import pytest

import cg
from cg.frames import SO3, Euclidean

POINTS = np.array([0.3, 0.7])
LINE = {"frame": Euclidean(1)}


def stairs(t, y, side="right"):
    """Return one more than the number of points before t; `side` decides at a point."""
    return [1.0 + np.searchsorted(POINTS, t, side=side)]


def test_those_at_the_ends_change_nothing_and_those_beyond_are_refused():
    without = cg.solve_ivp(stairs, (0.0, 0.2), [0.0], **LINE)
    solution = cg.solve_ivp(stairs, (0.0, 0.2), [0.0], breakpoints=[0.0, 0.2], **LINE)
    np.testing.assert_array_equal(solution.t, without.t)
    np.testing.assert_array_equal(solution.y, without.y)
    for points in ([-1.0], [0.1, 5.0]):
        with pytest.raises(ValueError, match=r"breakpoints must lie between the ends, 0 to 0\.2"):
            cg.solve_ivp(stairs, (0.0, 0.2), [0.0], breakpoints=points, **LINE)
        with pytest.raises(ValueError, match="breakpoints must lie between the ends, -1 to 0, got"):
            cg.Stepper(stairs, 0.0, [0.0], -1.0, breakpoints=[-0.5, -2.0], **LINE)


def test_warning_for_kinks_without_breakpoints():
    """The data are interpolated linearly."""
    times = np.linspace(0.0, 1.0, 1001)
    rates = np.random.default_rng(1).standard_normal((3, len(times)))

    f = lambda t, y: [np.interp(t, times, row) for row in rates]
    options = {"frame": SO3(), "method": "RKMK8(5,3)", "rtol": 1e-11, "atol": 1e-11}
    with pytest.warns(UserWarning, match="name them as breakpoints") as caught:
        poor = cg.solve_ivp(f, (0, 1), np.eye(3), **options)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        good = cg.solve_ivp(f, (0, 1), np.eye(3), breakpoints=times, **options)
    assert good.nrejected == 0
    assert good.nfev < 0.5 * poor.nfev
    assert np.isin(times, good.t).all()
