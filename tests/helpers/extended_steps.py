"""Steps in extended precision, on frames whose flows are given in it.

A user's frame, or one that isn't compiled, moves points in double precision only, whose rounding
hides the errors of the higher orders but for the largest steps.  Here is the same step, written
anew, with as many digits as real(16) has.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property, partial

import numpy as np
from flint import acb, arb, arb_mat, ctx, fmpq

from cg.problems.affine import AffineField
from cg.problems.taylor import exact_midpoint

BITS = 113
_SOLVED = 2.0 ** (8 - BITS)


def ball(x):
    exact = Fraction(x)
    return arb(fmpq(exact.numerator, exact.denominator))


def rows_of(matrix):
    return [[ball(float(x)) for x in row] for row in matrix]


@dataclass(frozen=True, eq=False)
class ExtendedProblem:
    """An `AffineField` whose flow ``flow(v, y)`` takes lists of coefficients and of entries."""

    problem: AffineField
    flow: Callable

    @cached_property
    def _f(self):
        p = self.problem
        return arb_mat(rows_of(np.column_stack([p.constant, p.slope, p.linear])))

    def f(self, t, y):
        column = arb_mat(len(y) + 2, 1, [arb(1), t, *y])
        return [x.mid() for x in (self._f * column).entries()]

    def compose(self, row, fields, y, h):
        # only midpoints go on: the radii of balls would grow far faster than their errors
        for entry, field in zip(row, fields, strict=True):
            if entry != 0:
                y = [x.mid() for x in self.flow([h * entry * v for v in field], y)]
        return y

    def explicit_step(self, method, weights, c, t, y, h):
        ends, fields = {-1: y}, {}
        for m, (point, row) in enumerate(zip(method.points, weights, strict=True)):
            for k in point.weights:
                if k not in fields:
                    fields[k] = self.f(t + c[k] * h, ends[method.stage_points[k]])
            v = [arb(0)] * len(self.problem.constant)
            for k, weight in row.items():
                v = [(x + h * weight * f).mid() for x, f in zip(v, fields[k], strict=True)]
            ends[m] = [x.mid() for x in self.flow(v, ends[point.parent])]
        return ends[method.result]

    def step(self, rows, b, t, y, h):
        fields = [self.f(t, y)] * len(b)
        for i, row in enumerate(rows):
            time = t + h * sum(row, arb())
            for _ in range(200):
                before, fields[i] = fields[i], self.f(time, self.compose(row, fields, y, h))
                change = max(abs(float(p - q)) for p, q in zip(before, fields[i], strict=True))
                if row[i] == 0 or change < _SOLVED:
                    break
            else:
                raise AssertionError(f"stage {i} isn't solved: it still changes by {change}")
        return self.compose(b, fields, y, h)

    def end(self, tableau, n):
        """Return the point at time 1 after ``n`` steps, as exact numbers.

        Implicit stages may need those before them only.
        """
        with ctx.workprec(BITS):
            a, b = tableau.exact
            if tableau.explicit:
                weights = [{k: ball(w) for k, w in p.weights.items()} for p in tableau.points]
                step = partial(self.explicit_step, tableau, weights, [ball(sum(row)) for row in a])
            else:
                step = partial(self.step, [[ball(x) for x in row] for row in a], list(map(ball, b)))
            h = 1 / arb(n)
            y = [ball(float(x)) for x in self.problem.y0.ravel()]
            for k in range(n):
                y = step(k * h, y, h)
            return [exact_midpoint(x) for x in y]


def left_flow(matrices):
    """Return the flow of ``y' = sum(v_i A_i) y`` for points of as many rows as the ``A_i``."""
    n = len(matrices[0])

    @cache
    def generators():
        return [arb_mat(rows_of(a)) for a in matrices]

    def flow(v, y):
        omega = arb_mat(n, n)
        for x, a in zip(v, generators(), strict=True):
            omega += x * a
        return (omega.exp() * arb_mat(n, len(y) // n, y)).entries()

    return flow


def right_flow(matrices):
    """Return the flow of ``y' = y sum(v_i A_i)`` for square points."""
    n = len(matrices[0])
    transposed = left_flow([a.T for a in matrices])

    def transpose(y):
        return arb_mat(n, n, y).transpose().entries()

    return lambda v, y: transpose(transposed(v, transpose(y)))


def similarity_flow(v, y):
    """Return the flow of ``z' = v0 + (v1 + i v2) z``."""
    rate, z = acb(v[1], v[2]), acb(*y)
    growth = rate.exp()
    moved = growth * z + v[0] * (growth - 1) / rate
    return [moved.real, moved.imag]
