"""Bad input to integrations, refused by its name before f is called; and odd, but honest input."""

import copy
import pickle
import warnings
from collections import UserDict
from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cg
from cg.frames import SO3, CoadjointOrbit, Euclidean, Product, UnitQuaternion
from cg.problems import AffineField
from cg.reproduce.reference_runs import integrate_compiled

ATTITUDE = Product(UnitQuaternion(), Euclidean(3))
QUATERNION = [0.0, 0.0, 0.0, 1.0]


def never(t, y):
    raise AssertionError("f was called although the arguments are bad")


def turn(t, y):
    return [1.0, 0.0, t]


def solve(f=never, t_span=(0.0, 1.0), y0=None, **options):
    options = {"frame": SO3()} | options
    return cg.solve_ivp(f, t_span, np.eye(3) if y0 is None else y0, **options)


@pytest.mark.parametrize(
    "t_span",
    [
        (False, True),
        (0.0, True),
        np.array([False, True]),
        (np.False_, 1.0),
        {0.0, 1.0},
        frozenset([0.0, 1.0]),
        {0.0: 1.0, 1.0: 2.0},
        UserDict({0.0: 1.0, 1.0: 2.0}),
        "01",
        b"01",
        (0.0, 1j),
        np.ma.masked_array([0.0, 1.0], mask=[0, 1]),
        [[0.0], [1.0]],
        1.0,
        None,
    ],
)
def test_spans(t_span):
    for options in ({}, {"h": 0.1}):
        with pytest.raises(ValueError, match="t_span must be two numbers, got"):
            solve(t_span=t_span, **options)
    with pytest.raises(ValueError, match="t_span must be two numbers, got"):
        cg.integrate(never, t_span, np.eye(3), frame=SO3(), method="CG2", h=0.1)


@pytest.mark.parametrize(
    "t_span", [[0, 1], np.array([0, 1]), (Fraction(0), Fraction(1)), np.float32([0, 1]), range(2)]
)
def test_spans_of_all_numbers(t_span):
    assert solve(turn, t_span, h=0.5).t.tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"stage_solver": ["newton"]}, ValueError, r"stage_solver must be .*, got \['newton'\]"),
        ({"dense_output": "no"}, TypeError, "dense_output must be True or False, got 'no'"),
        ({"dense_output": np.nan}, TypeError, "dense_output must be True or False, got nan"),
        ({"args": "ab"}, TypeError, "args must be a tuple .*, got 'ab'"),
        ({"args": b"ab"}, TypeError, "args must be a tuple .*, got b'ab'"),
        ({"args": {1, 2}}, TypeError, r"args must be a tuple .*, got \{1, 2\}"),
        ({"args": {"a": 1}}, TypeError, r"args must be a tuple .*, got \{'a': 1\}"),
        ({"h": np.float32("inf")}, ValueError, "h must be positive and finite, got .*inf"),
        ({"h": np.longdouble("1e4000")}, ValueError, "h must be positive and finite, got"),
        ({"h": Fraction(1, 10**400)}, ValueError, "h must be positive and finite, got"),
        ({"max_steps": True}, TypeError, "max_steps must be an integer, got True"),
    ],
)
def test_options(changes, error, message):
    with pytest.raises(error, match=message):
        solve(**changes)


def test_numbers_of_numpy_mean_what_they_hold():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = solve(turn, h=np.float32(0.25), max_step=np.float32(0.25))
        np.testing.assert_array_equal(found.y, solve(turn, h=0.25).y)
        assert solve(turn, max_steps=np.int64(500), dense_output=np.True_).sol is not None
        kept = cg.integrate(
            turn, (0, 1), np.eye(3), frame=SO3(), method="CG2", h=0.25, save_every=np.int64(2)
        )
        assert kept.t.tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"h": True}, "h must be a finite number, got True"),
        ({"h": np.True_}, "h must be a finite number, got np.True_"),
        ({"steps": 10**12}, "steps = 1000000000000 need .* GiB of memory, and there are"),
        ({"steps": 10**30}, "steps = 10{30} need .* GiB of memory, and there are"),
        ({"steps": True}, "steps must be an integer, got True"),
    ],
)
@pytest.mark.parametrize("kind", ["real64", "real128"])
def test_built_in_problems(changes, message, kind):
    problem = AffineField(Euclidean(1), [1.0])
    options = {"method": "CG2", "h": 0.5, "steps": 3, "kind": kind} | changes
    with pytest.raises((TypeError, ValueError), match=message):
        integrate_compiled(problem, **options)


def test_built_in_problems_take_integers_of_numpy():
    problem = AffineField(Euclidean(1), [1.0])
    assert len(integrate_compiled(problem, method="CG2", h=0.5, steps=np.int64(3)).t) == 4


@pytest.mark.parametrize(
    ("frame", "y0"),
    [
        (ATTITUDE, (QUATERNION, [0.0] * 3)),
        (ATTITUDE, [np.array(QUATERNION), np.zeros(3)]),
        (Product(Euclidean(3), Euclidean(3)), (np.zeros(3), np.zeros(3))),
        (Product(SO3(), Euclidean(1)), (np.eye(3), np.zeros(1))),
    ],
)
def test_parts_of_a_product_that_are_not_joined(frame, y0):
    with pytest.raises(ValueError, match=r"y0 .*frame\.join") as caught:
        solve(frame=frame, y0=y0, h=0.1)
    assert len(str(caught.value)) < 200
    points = frame.join(*y0)
    assert solve(lambda t, y: np.zeros(frame.dim), y0=points, frame=frame, h=0.5).success


@pytest.mark.parametrize("options", [{}, {"h": 0.25}])
@pytest.mark.parametrize("compiled_frame", [True, False])
@pytest.mark.parametrize("in_c", [True, False])
def test_continuous_solutions_can_be_pickled_whatever_f_is(options, compiled_frame, in_c, function):
    frame = SO3() if compiled_frame else CoadjointOrbit(SO3(), (1.0, 0.0, 0.0))
    y0 = np.eye(3) if compiled_frame else [1.0, 0.0, 0.0]
    f = function("jump") if in_c else lambda t, y: [1.0, t, y.ravel()[1]]
    solution = solve(f, y0=y0, frame=frame, dense_output=True, **options)
    times = np.linspace(0, 1, 7)
    for same in (copy.deepcopy(solution), pickle.loads(pickle.dumps(solution))):
        np.testing.assert_array_equal(same.y, solution.y)
        np.testing.assert_array_equal(same.sol(times), solution.sol(times))


@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize(
    ("frame", "y0"),
    [
        (UnitQuaternion(), [0.0, 0.0, 0.0, 1.0]),
        (Product(UnitQuaternion(), Euclidean(3)), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
    ],
)
def test_the_derivative_of_the_point_is_recognised(frame, y0, batch):
    start = np.broadcast_to(y0, (*batch, len(y0)))

    def solve(f):
        if batch:
            cg.solve_ensemble(f, (0, 1), start, frame=frame, vectorized=True)
        else:
            cg.solve_ivp(f, (0, 1), start, frame=frame)

    with pytest.raises(ValueError, match="coefficients of the frame's fields, not the deriv"):
        solve(lambda t, y: np.zeros_like(y))
    with pytest.raises(ValueError, match=rf"got shape \({'2, ' if batch else ''}2,?\) at t = 0$"):
        solve(lambda t, y: np.zeros((*batch, 2)))


def test_rotations_among_points_of_factors_are_to_be_joined():
    for parts in ((Rotation.identity(), [1.0, 0.0, 0.0]), [QUATERNION, [1.0, 0.0, 0.0]]):
        with pytest.raises(ValueError, match=r"got 2 parts: join them by frame\.join\(\*y0\)"):
            cg.solve_ivp(never, (0, 1), parts, frame=ATTITUDE)


def test_a_name_in_other_letters_is_recognised():
    with pytest.raises(KeyError, match=r"no method is named 'CG4A'; .*; similar names are CG4a"):
        cg.methods["CG4A"]
