"""The fixed-step integrator: results, counts, rejected arguments."""

from fractions import Fraction

import numpy as np
import pytest
from equal_grids import make_grid, times
from hypothesis import assume, example, given
from hypothesis import strategies as st
from kinds import FROZEN

from cg.construction.catalogue import methods
from cg.construction.methods.paths import paths_of
from cg.construction.methods.tableau import Tableau
from cg.frames import SO3
from cg.integration import integrate

pytestmark = pytest.mark.sanitize

EXPLICIT = [name for name, tableau in FROZEN.items() if tableau.explicit]


def spin(t, y):
    return np.array([y[0, 1] - 1.0, np.cos(t) + y[2, 2], 0.5 * y[1, 0]])


def solve(f=spin, t_span=(0.0, 1.0), y0=None, **changes):
    arguments = {"frame": SO3(), "method": "CG3", "h": 0.1} | changes
    return integrate(f, t_span, np.eye(3) if y0 is None else y0, **arguments)


def exponentials(method):
    if not isinstance(method, Tableau):
        ends = (*method.stage_points, method.result)
        return len({point for end in ends for point in method.tree.path(end)})
    a, b = method.exact
    return sum(x != 0 for row in a for x in row) + sum(x != 0 for x in b)


@pytest.mark.parametrize("name", EXPLICIT)
def test_counts(name):
    calls = []

    def f(t, y):
        calls.append(t)
        return spin(t, y)

    class Counting(SO3):
        flows = 0

        def flow(self, v, y):
            Counting.flows += 1
            return super().flow(v, y)

    solution = solve(f, frame=Counting(), method=name)
    tableau = methods[name]
    # the last stage may be the next step's first
    again = 1 if paths_of(tableau).final_stage in (0, tableau.stages + 1) else 0
    assert solution.nfev == len(calls) == 10 * (tableau.stages - 1) + (10 if again else 1)
    assert solution.nexp == Counting.flows == 10 * exponentials(tableau)
    abscissae = [
        k * 0.1 + c * 0.1
        for k in range(10)
        for i, c in enumerate(tableau.c)
        if again or k == 0 or i > 0
    ]
    np.testing.assert_allclose(calls, abscissae, rtol=0, atol=1e-15)


@given(
    start=st.floats(-1e3, 1e3), steps=st.integers(1, 400), h=st.floats(1e-4, 10.0),
    backward=st.booleans(),
)  # fmt: skip
@example(start=7.0, steps=155, h=3.3458908554794844, backward=True)
def test_grid_of_whole_steps_has_no_sliver_at_the_end(start, steps, h, backward):
    stop = start - steps * h if backward else start + steps * h
    t = times((start, stop), h)
    assert len(t) == steps + 1
    assert (t[0], t[-1]) == (start, stop)
    np.testing.assert_allclose(
        np.abs(np.diff(t)), h, rtol=0, atol=1e-14 * (1 + abs(start) + abs(stop))
    )


@given(
    start=st.sampled_from([0.0, 1.0, -3.7e3, 1.7e9]),
    span=st.floats(1e-6, 10.0),
    parts=st.floats(1.0, 50.0),
)
def test_elapsed_time_is_right_to_rounding_of_time(start, span, parts):
    stop = start + span
    assume(stop > start)
    h = (stop - start) / parts
    assume(h > 4 * np.spacing(abs(stop)))
    grid = make_grid((start, stop), h)
    elapsed = (grid.steps - 1) * Fraction(h) + Fraction(grid.last)
    off = abs(elapsed - (Fraction(stop) - Fraction(start)))
    assert off <= np.spacing(max(abs(start), abs(stop))) + grid.steps * np.spacing(h)
