"""Callbacks that fail at any call: the caller gets their own exception or a clear error.

The environment variable ``CG_FUZZ`` multiplies the number of examples.
"""

import os

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import cg

MANY = int(os.environ.get("CG_FUZZ", "1"))
FRAMES = {
    "SO3": (cg.frames.SO3(), np.eye(3), 3),
    "Euclidean": (cg.frames.Euclidean(2), np.ones(2), 2),
    "Sphere": (cg.frames.Sphere(3), np.array([0.0, 0.0, 1.0]), 3),
    "SE3": (cg.frames.SE3(), np.eye(4), 6),
    "SU": (cg.frames.SU(2), np.eye(2, dtype=complex), 3),
}
RAISED = [ValueError, StopIteration, KeyboardInterrupt, SystemExit, MemoryError, RecursionError]


class MineError(Exception):
    """An exception that no other code raises."""


def returned(size):
    """Return values, most of them wrong for a function that returns vectors of `size` entries."""
    right = np.full(size, 0.1)
    return [
        None, "x", b"", 0.1, True, [], {}, object(), [None] * size, ["a"] * size,
        right[:-1], np.append(right, 0.1), right[:, None], right[None], right.reshape(1, 1, -1),
        right * np.nan, right * np.inf, right * 1j, right.astype(str), right.astype(object),
        np.ma.masked_array(right, mask=True), [[0.1], [0.1, 0.2]], np.array(0.1), 10**400,
        right.astype("datetime64[s]"), (x for x in right), np.full(size, 1e308), right > 0,
    ]  # fmt: skip


class Wrong:
    """A function that raises or returns a wrong value after `at` calls."""

    def __init__(self, right, at, how):
        self.right, self.at, self.how, self.calls = right, at, how, 0
        self.raised = None

    def __call__(self, *arguments):
        self.calls += 1
        if self.calls <= self.at:
            return self.right(*arguments)
        if isinstance(self.how, type) and issubclass(self.how, BaseException):
            self.raised = self.how("mine")
            raise self.raised
        return self.how


def ends_well(call, wrong, allowed):
    """Check that a call succeeds, or raises the error of the callback or an allowed one."""
    caught = None
    try:
        call()
    except BaseException as error:
        caught = error
    if wrong.raised is not None:
        ours = [caught, getattr(caught, "__cause__", None), getattr(caught, "__context__", None)]
        assert any(one is wrong.raised for one in ours), repr(caught)
    elif caught is not None:
        assert isinstance(caught, allowed), repr(caught)
        assert str(caught)


WAYS = {
    "fixed": {"h": 0.25, "method": "CG4", "rtol": None, "atol": None},
    "implicit": {"h": 0.25, "method": "DICG3", "rtol": None, "atol": None},
    "events": {}, "dense": {"dense_output": True},
}  # fmt: skip
HOW = st.sampled_from([MineError, *RAISED]) | st.integers(0, 24)


@settings(max_examples=150 * MANY)
@given(
    st.sampled_from(sorted(FRAMES)),
    st.integers(0, 40),
    HOW,
    st.sampled_from(
        ["auto", "CG4(3)", "CF4(3)", "RKMK5(4)", "fixed", "implicit", "events", "dense"]
    ),
)
def test_right_hand_sides_and_events(name, at, how, way):
    frame, start, size = FRAMES[name]
    rates = np.linspace(0.1, 0.4, size)
    given_back = returned(size)
    how = given_back[how % len(given_back)] if isinstance(how, int) else how
    f = wrong = Wrong(lambda t, y: rates * np.cos(t), at, how)
    options = {"rtol": 1e-5, "atol": 1e-8} | WAYS.get(way, {"method": way})
    if way == "events":
        f, wrong = f.right, Wrong(lambda t, y: np.cos(3 * t), at, how)
        options["events"] = wrong
    ends_well(
        lambda: cg.solve_ivp(f, (0, 2), start, frame=frame, **options),
        wrong,
        (ValueError, TypeError, ArithmeticError),
    )


@settings(max_examples=80 * MANY)
@given(st.integers(0, 25), HOW)
def test_lmdif(at, how):
    given_back = returned(3)
    how = given_back[how % len(given_back)] if isinstance(how, int) else how
    wrong = Wrong(lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0], x[0]]), at, how)
    ends_well(lambda: cg.lmdif(wrong, [-1.2, 1.0]), wrong, (ValueError, TypeError))


@settings(max_examples=30 * MANY)
@given(st.integers(0, 6), HOW)
def test_progress(at, how):
    how = returned(3)[how % 25] if isinstance(how, int) else how
    wrong = Wrong(lambda *arguments: None, at, how)
    ends_well(lambda: cg.search(3, 3, 5, 0, workers=1, progress=wrong), wrong, ())
