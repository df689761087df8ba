"""Breakpoints: steps end there, and each step uses f on its own side."""

import ctypes
import warnings

import numpy as np
import pytest
from compiled_examples import DOUBLES

import cg
from cg.frames import SO3, Euclidean

POINTS = np.array([0.3, 0.7])
LINE = {"frame": Euclidean(1)}
WAYS = [{"h": 0.25, "method": "CG4a"}, {"h": 1.0, "method": "CG3"}, {"method": "CF4(3)"},
        {"method": "RKMK8(5,3)"}, {"h": 0.25, "method": "DICG3"}]  # fmt: skip


def stairs(t, y, side="right"):
    """Return one more than the number of points before t; `side` decides at a point."""
    return [1.0 + np.searchsorted(POINTS, t, side=side)]


def height(t):
    return t + np.maximum(t - POINTS[0], 0.0) + np.maximum(t - POINTS[1], 0.0)


def compiled(keep, side):
    """Return the stairs as a function in C that records its times."""

    def f(t, y, out, data):
        keep.append(t)
        out[0] = stairs(t, None, side)[0]
        return 0

    return ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p)(f)


@pytest.mark.parametrize("way", WAYS, ids=str)
@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize("side", ["left", "right"])
def test_steps_end_at_breakpoints_and_use_one_side(way, backward, in_c, side):
    times = []

    def f(t, y):
        times.append(t)
        return stairs(t, y, side)

    span, points = ((1.0, 0.0), POINTS[::-1]) if backward else ((0.0, 1.0), POINTS)
    solution = cg.solve_ivp(
        compiled(times, side) if in_c else f, span, [0.0], breakpoints=points, dense_output=True,
        **LINE, **way,
    )  # fmt: skip
    assert np.isin(points, solution.t).all()
    sign = -1.0 if backward else 1.0
    for point in points:
        assert np.nextafter(point, -sign * np.inf) in times
        assert point not in times
    first = [times.index(np.nextafter(p, sign * np.inf)) for p in points]
    last = [max(i for i, t in enumerate(times) if sign * (t - p) < 0.0) for p in points]
    assert all(a > b for a, b in zip(first, last, strict=True))
    start = height(span[0])
    np.testing.assert_allclose(solution.y[:, 0], height(solution.t) - start, rtol=0, atol=1e-13)
    t = np.linspace(0, 1, 101)
    np.testing.assert_allclose(solution.sol(t)[:, 0], height(t) - start, rtol=0, atol=1e-13)
    assert solution.nrejected == 0


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
