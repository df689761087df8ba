"""Conditions of random methods in the compiled core and in exact arithmetic."""

import random
from fractions import Fraction

import numpy as np
import pytest
from quad_core import residuals_quad
from slow_cases import slow

from cg import conditions
from cg.construction.layouts.layout import Layout, Rows
from cg.construction.layouts.points import START, Point, PointTree

HIGHEST = 7
# Each weight has at most eight factors, each of them rounded once; what is added up is positive
# in `sizes`, and no sum has more than some ten terms.
ROUNDINGS = 64


def drawn(rng):
    """Return a random fraction with one to three digits above and below the line."""
    return Fraction(rng.randint(-99, 99), rng.choice((1, 2, 3, 7, 16, 60, 97, 128, 999)))


def random_tableau(rng):
    stages = rng.randint(1, 5)
    rows = rng.choice(list(Rows))
    layout = Layout.tableau(stages, rows)
    return layout, [drawn(rng) for _ in range(layout.size)]


def random_points(rng):
    points, stages = [], [START]
    for m in range(rng.randint(1, 9)):
        used = sorted(rng.sample(range(len(stages)), min(len(stages), rng.randint(1, 3))))
        # the layout leaves out zeros
        weights = {stage: drawn(rng) or Fraction(1, 3) for stage in used}
        points.append(Point(rng.randint(START, m - 1), weights))
        if rng.random() < 0.5:
            stages.append(rng.randint(START, m))
    tree = PointTree(tuple(points), tuple(stages), rng.randint(0, len(points) - 1))
    return Layout.of_tree(tree), [w for point in points for w in point.weights.values()]


def compare(seed):
    """Return the largest errors of residuals in both precisions, in units of rounding."""
    rng = random.Random(seed)
    layout, x = random_points(rng) if seed % 2 else random_tableau(rng)
    order, independent = rng.randint(1, HIGHEST), rng.random() < 0.3
    expected = conditions.residuals(layout, x, order, independent, arithmetic="exact")
    doubles = np.array([float(value) for value in x])
    sizes = 1 + conditions.weights(layout, np.abs(doubles), order, independent)
    residuals = conditions.residuals(layout, doubles, order, independent)
    quads = residuals_quad(layout, x, order, independent)
    assert len(residuals) == len(quads) == len(expected) == conditions.count(order, independent)
    worst = [0.0, 0.0]
    for double, quad, true, size in zip(residuals, quads, expected, sizes, strict=True):
        errors = abs(Fraction(double) - true) * 2**53, abs(quad - true) * 2**113
        worst = [
            max(old, float(error / Fraction(size)))
            for old, error in zip(worst, errors, strict=True)
        ]
    assert max(worst) <= ROUNDINGS, (seed, worst)
    return worst


PARTS = [range(50 * part, 50 * (part + 1)) for part in range(4)]
MANY = [range(1000 * part, 1000 * (part + 1)) for part in range(10)]


@pytest.mark.parametrize("seeds", [*PARTS, *slow(*MANY)], ids=str)
def test_the_core_agrees_with_the_oracle(seeds):
    for seed in seeds:
        compare(seed)
