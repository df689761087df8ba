"""Least-squares problems of Moré, Garbow and Hillstrom, ACM TOMS 7 (1981) 17-41."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Residual = Callable[[Vector], Vector]


@dataclass(frozen=True)
class Problem:
    """One problem: m residuals of n unknowns.

    Sums are written out rather than left to BLAS, whose order of summation
    depends on the processor: a last digit can change a solver's path.
    """

    name: str
    m: int
    residual: Residual
    standard_start: tuple[float, ...]

    @property
    def n(self):
        return len(self.standard_start)

    def start(self, factor):
        """The standard start times `factor`; a zero start moves to `factor` itself."""
        start = np.array(self.standard_start)
        if factor != 1 and not start.any():
            return np.full(self.n, float(factor))
        return factor * start


def linear_rank_one(x, m):
    return np.arange(1, m + 1) * (np.arange(1, x.size + 1) * x).sum() - 1


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


BARD = np.array(
    [0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39]
)


def bard(x):
    u = np.arange(1.0, 16.0)
    v = 16 - u
    return BARD - (x[0] + u / (x[1] * v + x[2] * np.minimum(u, v)))


KOWALIK_OSBORNE_INVERSE_DOSE = np.array(
    [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]
)
KOWALIK_OSBORNE = np.array(
    [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
)


def kowalik_osborne(x):
    v = KOWALIK_OSBORNE_INVERSE_DOSE
    return KOWALIK_OSBORNE - x[0] * v * (v + x[1]) / (v * (v + x[2]) + x[3])


def brown_dennis(x, m):
    t = np.arange(1, m + 1) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + np.sin(t) * x[3] - np.cos(t)) ** 2


def chebyquad(x, m):
    """Means of the shifted Chebyshev polynomials minus their integrals over [0, 1]."""
    f = np.empty(m)
    shifted = 2 * x - 1
    previous, current = np.ones_like(x), shifted
    for i in range(1, m + 1):
        f[i - 1] = current.mean() + (1 / (i**2 - 1) if i % 2 == 0 else 0.0)
        previous, current = current, 2 * shifted * current - previous
    return f


OSBORNE_1 = np.array([
    0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751,
    0.718, 0.685, 0.658, 0.628, 0.603, 0.580, 0.558, 0.538, 0.522, 0.506, 0.490,
    0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420, 0.414, 0.411, 0.406,
])  # fmt: skip


def osborne_1(x):
    t = 10.0 * np.arange(33)
    return OSBORNE_1 - (x[0] + x[1] * np.exp(-x[3] * t) + x[2] * np.exp(-x[4] * t))


def _with_rows(name, m, function, start):
    return Problem(name, m, partial(function, m=m), start)


def _chebyquad(n):
    start = tuple(float(v) for v in np.arange(1, n + 1) / (n + 1))
    return _with_rows(f"chebyquad-{n}", max(n, 8), chebyquad, start)


ONES = (1.0,) * 5

PROBLEMS = (
    _with_rows("linear-rank-one", 50, linear_rank_one, ONES),
    Problem("rosenbrock", 2, rosenbrock, (-1.2, 1.0)),
    Problem("bard", 15, bard, (1.0, 1.0, 1.0)),
    Problem("kowalik-osborne", 11, kowalik_osborne, (0.25, 0.39, 0.415, 0.39)),
    _with_rows("brown-dennis", 20, brown_dennis, (25.0, 5.0, -5.0, -1.0)),
    *map(_chebyquad, (1, 8, 10)),
    Problem("osborne-1", 33, osborne_1, (0.5, 1.5, -1.0, 0.01, 0.02)),
)
