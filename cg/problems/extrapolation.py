"""Reference solutions of any differential equation, by extrapolation in extended precision.

Nothing here knows of methods on manifolds, so that they can be tested against it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction

from flint import acb_mat

from cg.support.balls import to_ball

State = list[acb_mat]
Field = Callable[[State], State]


def extrapolated(
    field: Field, start: State, times: Sequence[Fraction], step: Fraction, columns: int
) -> list[State]:
    """Solve an autonomous equation by the midpoint rule, extrapolated to order ``2 * columns``.

    Parameters
    ----------
    field
        The right side, for a state of complex matrices.
    start
        The state at time zero.
    times
        Where the solution is wanted, of any sign and in any order.
    step
        Length of the steps that are extrapolated.
    columns
        How many numbers of midpoint steps in each: 2, 4, 6 and so on.

    References
    ----------
    .. [1] E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd
       ed., Springer, 1993, section II.9.
    """
    found: dict[Fraction, State] = {Fraction(0): start}
    for sign in (1, -1):
        now, state = Fraction(0), start
        for t in sorted({t for t in times if t * sign > 0}, key=abs):
            while now != t:
                length = min(step, abs(t - now)) * sign
                state = _step(field, state, length, columns)
                now += length
            found[t] = state
    return [found[t] for t in times]


def _step(field: Field, state: State, length: Fraction, columns: int) -> State:
    slope = field(state)
    row: list[State] = []
    for j in range(1, columns + 1):
        last = [_midpoints(field, state, slope, length, 2 * j)]
        for k, other in enumerate(row):
            # The errors are even in the length of a step.
            ratio = Fraction(j, j - 1 - k) ** 2 - 1
            factor = to_ball(1 / ratio)
            last.append([x + (x - y) * factor for x, y in zip(last[k], other, strict=True)])
        row = last
    return [x.mid() for x in row[-1]]


def _midpoints(field: Field, state: State, slope: State, length: Fraction, n: int) -> State:
    """Return the state after ``n`` steps of the midpoint rule, the first of them Euler's."""
    h = to_ball(length / n)
    before, now = state, [x + s * h for x, s in zip(state, slope, strict=True)]
    for _ in range(n - 1):
        slopes = field(now)
        before, now = now, [(x + s * (2 * h)).mid() for x, s in zip(before, slopes, strict=True)]
    return now
