"""Least-squares problems of Moré, Garbow and Hillstrom, ACM TOMS 7 (1981) 17-41.

Every problem has its standard start and the sums of squares at its published minima.
"""

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

    `tries` is how many of the starts ×1, ×10, ×100 MINPACK's driver takes, and
    `minima` the known sums of squares at local minima (those at infinity too).
    Sums are written out rather than left to BLAS, whose order of summation
    depends on the processor: a last digit can change a solver's path.
    """

    name: str
    m: int
    residual: Residual
    standard_start: tuple[float, ...]
    tries: int
    minima: tuple[float, ...]

    @property
    def n(self):
        return len(self.standard_start)

    def start(self, factor):
        """The standard start times `factor`; a zero start moves to `factor` itself."""
        start = np.array(self.standard_start)
        if factor != 1 and not start.any():
            return np.full(self.n, float(factor))
        return factor * start


def linear_full_rank(x, m):
    f = np.full(m, -2 * x.sum() / m - 1)
    f[: x.size] += x
    return f


def linear_rank_one(x, m):
    return np.arange(1, m + 1) * (np.arange(1, x.size + 1) * x).sum() - 1


def zero_borders(x, m):
    inner = (np.arange(2, x.size) * x[1:-1]).sum()
    f = np.arange(m) * inner - 1
    f[-1] = -1
    return f


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def helical_valley(x):
    if x[0] == 0:
        turns = np.copysign(0.25, x[1])
    else:
        turns = np.arctan(x[1] / x[0]) / (2 * np.pi) + (0.5 if x[0] < 0 else 0.0)
    return np.array([10 * (x[2] - 10 * turns), 10 * (np.sqrt(x[0] ** 2 + x[1] ** 2) - 1), x[2]])


def powell_singular(x):
    return np.array(
        [
            x[0] + 10 * x[1], np.sqrt(5) * (x[2] - x[3]), (x[1] - 2 * x[2]) ** 2,
            np.sqrt(10) * (x[0] - x[3]) ** 2,
        ]
    )  # fmt: skip


def freudenstein_roth(x):
    return np.array(
        [-13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1], -29 + x[0] + ((1 + x[1]) * x[1] - 14) * x[1]]
    )


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


def box_three_dimensional(x, m):
    i = np.arange(1, m + 1)
    t = i / 10
    return np.exp(-t * x[0]) - np.exp(-t * x[1]) + (np.exp(-i) - np.exp(-t)) * x[2]


def jennrich_sampson(x, m):
    i = np.arange(1, m + 1)
    return 2 + 2 * i - np.exp(i * x[0]) - np.exp(i * x[1])


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


def brown_almost_linear(x):
    f = x + x.sum() - (x.size + 1)
    f[-1] = x.prod() - 1
    return f


OSBORNE_1 = np.array(
    [
        *(0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751),
        *(0.718, 0.685, 0.658, 0.628, 0.603, 0.580, 0.558, 0.538, 0.522, 0.506, 0.490),
        *(0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420, 0.414, 0.411, 0.406),
    ]
)


def osborne_1(x):
    t = 10.0 * np.arange(33)
    return OSBORNE_1 - (x[0] + x[1] * np.exp(-x[3] * t) + x[2] * np.exp(-x[4] * t))


def _with_rows(function, m):
    return partial(function, m=m)


def _chebyquad(n, tries, *minima):
    start = tuple(float(v) for v in np.arange(1, n + 1) / (n + 1))
    m = max(n, 8)
    return Problem(f"chebyquad-{n}", m, _with_rows(chebyquad, m), start, tries, minima)


ONES = (1.0,) * 5

PROBLEMS = (
    Problem("linear-full-rank", 10, _with_rows(linear_full_rank, 10), ONES, 1, (5.0,)),
    Problem("linear-rank-one", 50, _with_rows(linear_rank_one, 50), ONES, 1, (2450 / 202,)),
    Problem("linear-rank-one-zero-borders", 10, _with_rows(zero_borders, 10), ONES, 1, (124 / 34,)),
    Problem("rosenbrock", 2, rosenbrock, (-1.2, 1.0), 3, (0.0,)),
    Problem("helical-valley", 3, helical_valley, (-1.0, 0.0, 0.0), 3, (0.0,)),
    Problem("powell-singular", 4, powell_singular, (3.0, -1.0, 0.0, 1.0), 3, (0.0,)),
    Problem("freudenstein-roth", 2, freudenstein_roth, (0.5, -2.0), 3, (0.0, 48.98425)),
    Problem("bard", 15, bard, (1.0, 1.0, 1.0), 3, (8.214877e-3, 17.42869)),
    Problem(
        "kowalik-osborne", 11, kowalik_osborne, (0.25, 0.39, 0.415, 0.39), 3,
        (3.075056e-4, 1.027342e-3),
    ),
    Problem(
        "box-three-dimensional",
        10,
        _with_rows(box_three_dimensional, 10),
        (0.0, 10.0, 20.0),
        1,
        (0.0,),
    ),
    Problem("jennrich-sampson", 10, _with_rows(jennrich_sampson, 10), (0.3, 0.4), 1, (124.3622,)),
    Problem(
        "brown-dennis", 20, _with_rows(brown_dennis, 20), (25.0, 5.0, -5.0, -1.0), 3, (85822.20,)
    ),
    _chebyquad(1, 3, 3.557893, 3.550391),
    _chebyquad(8, 1, 3.516874e-3),
    _chebyquad(9, 1, 0.0),
    _chebyquad(10, 1, 4.772714e-3, 6.503955e-3),
    Problem("brown-almost-linear-10", 10, brown_almost_linear, (0.5,) * 10, 3, (0.0, 1.0)),
    Problem("brown-almost-linear-30", 30, brown_almost_linear, (0.5,) * 30, 1, (0.0, 1.0)),
    Problem("brown-almost-linear-40", 40, brown_almost_linear, (0.5,) * 40, 1, (0.0, 1.0)),
    Problem("osborne-1", 33, osborne_1, (0.5, 1.5, -1.0, 0.01, 0.02), 1, (5.464895e-5,)),
)  # fmt: skip
