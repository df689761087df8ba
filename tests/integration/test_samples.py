"""Curves through samples."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
from refusals import refuses
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from cg.integration.rhs.samples import Samples

RNG = np.random.default_rng(5)
TIMES = np.cumsum(RNG.uniform(0.1, 1.0, 9))
VALUES = RNG.standard_normal((9, 2))


def test_held_values_begin_at_their_times():
    held = Samples(TIMES, VALUES, end=20.0)
    for k, t in enumerate(TIMES):
        np.testing.assert_array_equal(held(t), VALUES[k])
        if k:
            np.testing.assert_array_equal(held(np.nextafter(t, 0)), VALUES[k - 1])
    np.testing.assert_array_equal(held.corners(), TIMES[1:])
    np.testing.assert_array_equal(held(20.0), VALUES[-1])


def test_lines_and_splines_interpolate():
    for kind in ("linear", "cubic"):
        curve = Samples(TIMES, VALUES, kind)
        np.testing.assert_allclose([curve(t) for t in TIMES], VALUES, rtol=0, atol=1e-14)
    t = np.linspace(TIMES[0], TIMES[-1], 50)
    np.testing.assert_allclose(
        [curve(s) for s in t], CubicSpline(TIMES, VALUES)(t), rtol=0, atol=4e-14
    )
    assert curve.corners().size == 0
    np.testing.assert_array_equal(Samples(TIMES, VALUES, "linear").corners(), TIMES[1:-1])


def test_times_without_a_jump_are_no_corners():
    assert Samples([0, 1, 2, 3], [1.0, 1.0, 2.0, 2.0]).corners().tolist() == [2.0]
    assert Samples([0, 1, 2, 3], [0.0, 1.0, 2.0, 2.0], "linear").corners().tolist() == [2.0]


@pytest.mark.parametrize(("start", "slope"), [(0.0, 1.0), (-3.0, 1e6), (1.7e9, 0.3), (0.0, -2e-7)])
def test_rounding_makes_no_corners_of_a_ramp(start, slope):
    times = start + 0.1 * np.arange(51)
    for offset in (0.0, 3.0, 1e5 * slope):
        values = offset + slope * (times - start)
        means = (values[1:] + values[:-1]) / 2
        causal = Samples(times, means, "averages", causal=True)
        assert causal.corners().tolist() == [times[1]]  # the first interval is constant
        for curve in (Samples(times, values, "linear"), Samples(times, means, "averages")):
            assert curve.corners(1e-10).size == 0
    bent = slope * (times - start)
    bent[20] += slope * (1e-4 if start > 1e6 else 1e-9)  # times that large have few digits
    assert Samples(times, bent, "linear").corners().tolist() == times[19:22].tolist()


@pytest.mark.parametrize("causal", [False, True])
def test_averages_are_means_of_the_curve(causal):
    curve = Samples(TIMES, VALUES[:-1], "averages", causal=causal)
    for k, (a, b) in enumerate(pairwise(TIMES)):
        mean = quad(lambda t: curve(t)[1], a, np.nextafter(b, 0))[0] / (b - a)
        assert mean == pytest.approx(VALUES[k, 1], abs=4e-14)
        if not causal and k:
            np.testing.assert_allclose(curve(a), curve(np.nextafter(a, 0)), rtol=0, atol=3e-13)
    assert len(curve.corners()) == (len(TIMES) - 2 if causal else 0)


def test_causal_averages_use_no_later_interval():
    changed = VALUES[:-1].copy()
    changed[5:] += 1.0
    first, second = (Samples(TIMES, v, "averages", causal=True) for v in (VALUES[:-1], changed))
    t = np.nextafter(TIMES[5], 0)
    np.testing.assert_array_equal(first(t), second(t))


def test_values_of_members_and_of_one_number():
    values = RNG.standard_normal((3, 9))
    curve = Samples(TIMES, values, "linear", members=True)
    assert curve.members == 3
    assert curve.shape == ()
    single = Samples(TIMES, values[1], "linear")
    assert curve(1.5, 1) == single(1.5)
    assert isinstance(single(1.5), float)
    np.testing.assert_array_equal(curve(1.5), [curve(1.5, k) for k in range(3)])


REFUSED = [
    (([0, 1], [1, 2]), {"kind": "spline"}, "kind"), (([1, 0], [1, 2]), {}, "times must increase"),
    (([0, 0], [1, 2]), {}, "times must increase"), (([0, np.nan], [1, 2]), {}, "times"),
    (([[0, 1]], [1, 2]), {}, "times"), (([], []), {}, "times"),
    (([0], [1]), {"kind": "linear"}, "at least 2"), (([0, 1], [1, np.inf]), {}, "values"),
    (([0, 1], [1, 2, 3]), {}, "values"), (([0, 1], [1, 2]), {"kind": "averages"}, "one less"),
    (([0, 1], [1, 2]), {"members": True}, "members"),
    (([0, 1], [1, 2]), {"kind": "linear", "end": 3}, "end"),
    (([0, 1], [1, 2]), {"end": 0.5}, "end"), (([0, 1], [1, 2]), {"causal": True}, "causal"),
    (([0, 1], ["a", 2]), {}, "values"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "options", "word"), REFUSED)
def test_bad_input_is_named(arguments, options, word):
    refuses(ValueError, word, Samples, *arguments, **options)


def test_a_time_that_is_no_number_is_named():
    curve = Samples([0.0, 1.0], [1.0, 2.0], "linear")
    message = "t must lie within the times of the samples, 0 to 1, got nan$"
    refuses(ValueError, message, curve, float("nan"))
    refuses(ValueError, message, curve.at, np.array([0.5, np.nan]))
    refuses(TypeError, "t must be a real number, got 'a'", curve, "a")


@pytest.mark.parametrize("kind", ["hold", "linear", "cubic"])
@pytest.mark.parametrize("members", [False, True])
def test_values_belong_to_the_caller(kind, members):
    values = np.arange(24.0).reshape(2, 4, 3) if members else np.arange(12.0).reshape(4, 3)
    read = Samples(np.arange(4.0), values, kind, members=members).reader(1 if members else None)
    before = read(1.0).copy()
    read(1.0)[...] = 7.0
    np.testing.assert_array_equal(read(1.0), before)


@pytest.mark.parametrize("kind", ["hold", "linear", "cubic", "averages"])
def test_a_part_is_computed_from_its_own_members(kind):
    times = np.linspace(0.0, 1.0, 6 if kind == "averages" else 5)
    values = RNG.standard_normal((3, 5, 2))
    whole = Samples(times, values, kind, end=1.5 if kind == "hold" else None, members=True)
    assert len(whole(0.3)) == len(whole._rounding) // 2 == 3  # which keeps what it is computed from
    alone = Samples(times, values[1:], kind, end=1.5 if kind == "hold" else None, members=True)
    some = whole.of_members(slice(1, 3))
    for curve in (some, pickle.loads(pickle.dumps(some))):
        np.testing.assert_array_equal(curve(0.3), alone(0.3))
        np.testing.assert_array_equal(curve._rounding, alone._rounding)
