"""Steps in extended precision, on frames whose flows are given in it.

A user's frame, or one that isn't compiled, moves points in double precision only, whose rounding
hides the errors of the higher orders but for the largest steps.  Here is the same step, written
anew, with as many digits as real(16) has.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property

import numpy as np
from flint import acb, arb, arb_mat, ctx, fmpq

from cg.commutator_free import CommutatorFree
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

    def step_by_points(self, tree, t, y, h):
        """Take a step of an explicit method whose flows have several weights."""
        reached, times, fields = {-1: y}, {-1: t}, {}

        def evaluate(m):
            for stage, at in enumerate(tree.stage_points):
                if at == m:
                    fields[stage] = self.f(times[m], reached[m])

        evaluate(-1)
        for m, point in enumerate(tree.points):
            weights = {stage: ball(weight) for stage, weight in point.weights.items()}
            sums = [
                sum((w * fields[k][i] for k, w in weights.items()), arb())
                for i in range(len(fields[0]))
            ]
            start = reached[point.parent]
            reached[m] = [x.mid() for x in self.flow([h * v for v in sums], start)]
            times[m] = times[point.parent] + h * sum(weights.values(), arb())
            evaluate(m)
        return reached[tree.result]

    def end(self, tableau, n):
        """Return the point at time 1 after ``n`` steps, as exact numbers.

        Implicit stages may need those before them only.
        """
        with ctx.workprec(BITS):
            h = 1 / arb(n)
            y = [ball(float(x)) for x in self.problem.y0.ravel()]
            if isinstance(tableau, CommutatorFree):
                for k in range(n):
                    y = self.step_by_points(tableau.tree, k * h, y, h)
                return [exact_midpoint(x) for x in y]
            a, b = tableau.exact
            rows, b = [[ball(x) for x in row] for row in a], [ball(x) for x in b]
            for k in range(n):
                y = self.step(rows, b, k * h, y, h)
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
