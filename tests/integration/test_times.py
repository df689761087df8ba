"""Times in messages, and times that lie at the end of a span up to rounding."""

import numpy as np
import pytest

import cg
from cg.frames import Euclidean

EPOCH = 1.7e9  # seconds since 1970
STAMPS = EPOCH + np.array([0.0, 0.01, 0.02])


def rise(t, y, *_):
    return [1.0]


def advance(t):
    cg.Stepper(rise, EPOCH, [0.0], EPOCH + 0.05, frame=Euclidean(1)).advance(t)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: cg.Samples(STAMPS[[0, 2, 1]], np.ones(3)), "got .*.01 after .*.02"),
        (lambda: cg.Samples(STAMPS[[0, 2, 2]], np.ones(3)), "got .*.02 after .*.02"),
        (lambda: solve_late(inputs=cg.Samples([0, EPOCH], [1, 1], "linear")), "0 to .*, got .*.05"),
        (lambda: solve_late(t_eval=[EPOCH, EPOCH + 0.06]), r"to .*\.05, got .*\.06 at \[1\]"),
        (lambda: solve_late(t_eval=[EPOCH + 0.02, EPOCH + 0.01]), r"got .*\.01 after .*\.02"),
        (lambda: solve_late(breakpoints=[EPOCH + 0.06]), r"to .*\.05, got .*\.06"),
        (lambda: solve_late(dense_output=True).sol(EPOCH + 0.06), r"and .*\.05, got .*\.06"),
        (lambda: advance(EPOCH + 0.06), r"between 17.* and .*\.05, got .*\.06"),
    ],
)  # fmt: skip
def test_messages_tell_times_apart(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def solve_late(**options):
    return cg.solve_ivp(rise, (EPOCH, EPOCH + 0.05), [0.0], frame=Euclidean(1), **options)
