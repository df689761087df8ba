"""Ensembles: every member is what it is alone, whatever else is asked for."""

import itertools
import pickle
import tracemalloc

import numpy as np
import pytest

import cg
from cg.frames import GL, SO3, SU, Euclidean, Stiefel
from cg.integration.arguments import check_points

COUNTS = ("steps", "nrejected", "nfev", "nexp", "njev", "nlu", "status", "success")
FRAMES = {
    "SO3": SO3(), "SU2": SU(2), "Euclidean": Euclidean(3), "Stiefel": Stiefel(4, 2), "GL": GL(2),
}  # fmt: skip
STEPS = {
    "fixed": {"method": "CG4a", "h": 0.3},
    "chosen": {"method": "CF4(3)", "rtol": 1e-5, "atol": 1e-5},
    "implicit": {"method": "DICG4", "h": 0.3},
    "Munthe-Kaas": {"method": "RKMK5(4)", "rtol": 1e-5, "atol": 1e-5},
    "fixed Munthe-Kaas": {"method": "RKMK4", "h": 0.3},
}
MEMBERS = 3


def driven(t, y, weight, row):
    """Return the coefficients of one point in Python."""
    values = y.reshape(-1).view(float)
    i = np.arange(int(row[2]))
    return row[0] * np.cos(t + i) + weight * values[(5 * i + 1) % values.size]


def all_driven(t, y, weight, rows):
    """Return the coefficients of any number of points."""
    values = y.reshape(len(t), -1).view(float)
    i = np.arange(int(rows[0, 2]))
    mixed = values[:, (5 * i + 1) % values.shape[1]]
    return rows[:, :1] * np.cos(t[:, None] + i) + weight * mixed


def time_of(value, **attributes):
    def event(t, y, *others):
        assert len(others) in (1, 2)
        assert others[-1].shape == (4,)  # the member's own row
        assert not y.flags.writeable
        return t - value * others[-1][0]

    vars(event).update(attributes)
    return event


def halfway(t, y, *others):
    return y


def outputs(span):
    between = np.linspace(*span, 7)
    middle = 0.5 * sum(span)
    return {
        "ends": {},
        "times": {"t_eval": between[1:-1]},
        "no times": {"t_eval": []},
        "dense": {"dense_output": True},
        "dense and times": {"dense_output": True, "t_eval": between},
        "events": {"events": [time_of(0.6), time_of(middle, direction=-1)]},
        "terminal": {"events": time_of(0.6, terminal=True), "dense_output": True},
        "jumps": {"events": cg.Event(time_of(0.5), jump=halfway), "t_eval": between},
        "breakpoints": {"breakpoints": [middle], "t_eval": between, "dense_output": True},
    }


def problem(kind, frame, function):
    """Return the function, its points, rows of parameters, and further arguments."""
    points = frame.random_point(np.random.default_rng(7), MEMBERS)
    width = points[0].view(float).size
    rows = np.array([[1.0 + 0.2 * k, 0.5, frame.dim, width] for k in range(MEMBERS)])
    options = {"frame": frame, "parameters": rows}
    if kind == "compiled":
        return function("driven"), points, options
    options["args"] = (0.5,)
    return (driven if kind == "python" else all_driven), points, options


def members_alone(f, span, y0, parameters=None, **options):
    """Return each member's own solution, at the ends of the span unless times are wanted."""
    options.setdefault("t_eval", list(dict.fromkeys(span)))
    rows = itertools.repeat(None) if parameters is None else parameters
    return [
        cg.solve_ivp(f, span, point, parameters=row, **options)
        for point, row in zip(y0, rows, strict=False)
    ]


def check(found, apart, *, atol=0.0):
    """Check that members of an ensemble are their own solutions."""
    assert len(found) == len(apart)
    assert found.y.shape == (len(found.t), len(apart), *found.frame.point_shape)
    assert not found.y.flags.writeable
    assert not found.t.flags.writeable
    for i, alone in enumerate(apart):
        member = found[i]
        same(member.t, alone.t, atol)
        same(member.y, alone.y, atol)
        n = len(alone.t)
        same(found.y[:n, i], alone.y, atol)
        assert np.isnan(found.y[n:, i]).all()
        for count in COUNTS:
            assert getattr(member, count) == getattr(alone, count)
            if count != "success":
                assert getattr(found, count)[i] == getattr(alone, count)
        assert (member.method, member.frame, member.h) == (alone.method, alone.frame, alone.h)
        assert member.message == alone.message
        assert (member.t_events is None) == (alone.t_events is None)
        for name in ("t_events", "y_events", "y_after"):
            for j, wanted in enumerate(getattr(alone, name) or ()):
                same(getattr(member, name)[j], wanted, atol)
                same(getattr(found, name)[j][i], wanted, atol)
        assert (member.sol is None) == (alone.sol is None)
        if alone.sol is not None:
            same(member.sol.ts, alone.sol.ts, 1e4 * atol)
            ends = np.sort([member.sol.t_min, member.sol.t_max])
            where = np.linspace(*ends, 11)
            same(member.sol(where), alone.sol(np.clip(where, alone.sol.t_min, alone.sol.t_max)), atol)
            same(found.sol(where)[:, i], member.sol(where), 0.0)


def same(found, wanted, atol):
    assert found.dtype == wanted.dtype
    assert found.shape == wanted.shape
    if atol:
        np.testing.assert_allclose(found, wanted, rtol=0, atol=atol)
    else:
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("span", [(0.0, 1.0), (1.0, -0.25)], ids=repr)
@pytest.mark.parametrize("output", outputs((0.0, 1.0)))
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("kind", ["python", "vectorized", "compiled"])
def test_members_are_what_they_are_alone(kind, frame, steps, output, span, function):
    if frame == "Stiefel" and "Munthe-Kaas" in steps:
        pytest.skip("its vector fields are those of a group, tested with the others")
    f, y0, options = problem(kind, FRAMES[frame], function)
    options |= STEPS[steps] | outputs(span)[output]
    found = cg.solve_ensemble(f, span, y0, vectorized=kind == "vectorized", **options)
    alone = driven if kind == "vectorized" else f
    # an error estimate is a small difference, so that steps agree to fewer digits
    atol = (1e-10 if "rtol" in options else 1e-13) if kind == "vectorized" else 0.0
    check(found, members_alone(alone, span, y0, **options), atol=atol)
