"""The least-squares problems of Moré, Garbow and Hillstrom.

J. J. Moré, B. S. Garbow, K. E. Hillstrom, Testing unconstrained optimization
software, ACM TOMS 7 (1981) 17-41, in the sizes that MINPACK's test driver of
lmdif runs. Every problem carries its standard start and the sums of squares
at its published minima, so that a wrong digit in a data table shows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
    def n(self) -> int:
        return len(self.standard_start)

    def start(self, factor: float) -> Vector:
        """The standard start times `factor`; a zero start moves to `factor` itself."""
        start = np.array(self.standard_start)
        if factor != 1 and not start.any():
            return np.full(self.n, float(factor))
        return factor * start


def linear_full_rank(x: Vector, m: int) -> Vector:
    f = np.full(m, -2 * x.sum() / m - 1)
    f[: x.size] += x
    return f


def linear_rank_one(x: Vector, m: int) -> Vector:
    return np.arange(1, m + 1) * (np.arange(1, x.size + 1) * x).sum() - 1


def linear_rank_one_zero_borders(x: Vector, m: int) -> Vector:
    inner = (np.arange(2, x.size) * x[1:-1]).sum()
    f = np.arange(m) * inner - 1
    f[-1] = -1
    return f


def rosenbrock(x: Vector) -> Vector:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def helical_valley(x: Vector) -> Vector:
    if x[0] == 0:
        turns = np.copysign(0.25, x[1])
    else:
        turns = np.arctan(x[1] / x[0]) / (2 * np.pi) + (0.5 if x[0] < 0 else 0.0)
    return np.array([10 * (x[2] - 10 * turns), 10 * (np.sqrt(x[0] ** 2 + x[1] ** 2) - 1), x[2]])


def powell_singular(x: Vector) -> Vector:
    return np.array(
        [
            x[0] + 10 * x[1],
            np.sqrt(5) * (x[2] - x[3]),
            (x[1] - 2 * x[2]) ** 2,
            np.sqrt(10) * (x[0] - x[3]) ** 2,
        ]
    )


def freudenstein_roth(x: Vector) -> Vector:
    return np.array(
        [-13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1], -29 + x[0] + ((1 + x[1]) * x[1] - 14) * x[1]]
    )


BARD = np.array(
    [0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39]
)


def bard(x: Vector) -> Vector:
    u = np.arange(1.0, 16.0)
    v = 16 - u
    return BARD - (x[0] + u / (x[1] * v + x[2] * np.minimum(u, v)))


KOWALIK_OSBORNE_INVERSE_DOSE = np.array(
    [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]
)
KOWALIK_OSBORNE = np.array(
    [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
)


def kowalik_osborne(x: Vector) -> Vector:
    v = KOWALIK_OSBORNE_INVERSE_DOSE
    return KOWALIK_OSBORNE - x[0] * v * (v + x[1]) / (v * (v + x[2]) + x[3])


MEYER = np.array(
    [
        *(34780, 28610, 23650, 19630, 16370, 13720, 11540, 9744),
        *(8261, 7030, 6005, 5147, 4427, 3820, 3307, 2872),
    ],
    dtype=float,
)


def meyer(x: Vector) -> Vector:
    return x[0] * np.exp(x[1] / (45 + 5 * np.arange(1, 17) + x[2])) - MEYER


def watson(x: Vector) -> Vector:
    powers = (np.arange(1, 30) / 29)[:, None] ** np.arange(x.size)
    slope = powers[:, :-1] @ (np.arange(1, x.size) * x[1:])
    return np.concatenate([slope - (powers @ x) ** 2 - 1, [x[0], x[1] - x[0] ** 2 - 1]])


def box_three_dimensional(x: Vector, m: int) -> Vector:
    i = np.arange(1, m + 1)
    t = i / 10
    return np.exp(-t * x[0]) - np.exp(-t * x[1]) + (np.exp(-i) - np.exp(-t)) * x[2]


def jennrich_sampson(x: Vector, m: int) -> Vector:
    i = np.arange(1, m + 1)
    return 2 + 2 * i - np.exp(i * x[0]) - np.exp(i * x[1])


def brown_dennis(x: Vector, m: int) -> Vector:
    t = np.arange(1, m + 1) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + np.sin(t) * x[3] - np.cos(t)) ** 2


def chebyquad(x: Vector, m: int) -> Vector:
    """Means of the shifted Chebyshev polynomials minus their integrals over [0, 1]."""
    f = np.empty(m)
    shifted = 2 * x - 1
    previous, current = np.ones_like(x), shifted
    for i in range(1, m + 1):
        f[i - 1] = current.mean() + (1 / (i**2 - 1) if i % 2 == 0 else 0.0)
        previous, current = current, 2 * shifted * current - previous
    return f


def brown_almost_linear(x: Vector) -> Vector:
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


def osborne_1(x: Vector) -> Vector:
    t = 10.0 * np.arange(33)
    return OSBORNE_1 - (x[0] + x[1] * np.exp(-x[3] * t) + x[2] * np.exp(-x[4] * t))


OSBORNE_2 = np.array(
    [
        *(
            *(1.366, 1.191, 1.112, 1.013, 0.991, 0.885, 0.831, 0.847, 0.786, 0.725, 0.746, 0.679),
            0.608,
        ),
        *(
            *(0.655, 0.616, 0.606, 0.602, 0.626, 0.651, 0.724, 0.649, 0.649, 0.694, 0.644, 0.624),
            0.661,
        ),
        *(
            *(0.612, 0.558, 0.533, 0.495, 0.500, 0.423, 0.395, 0.375, 0.372, 0.391, 0.396, 0.405),
            0.428,
        ),
        *(
            *(0.429, 0.523, 0.562, 0.607, 0.653, 0.672, 0.708, 0.633, 0.668, 0.645, 0.632, 0.591),
            0.559,
        ),
        *(
            *(0.597, 0.625, 0.739, 0.710, 0.729, 0.720, 0.636, 0.581, 0.428, 0.292, 0.162, 0.098),
            0.054,
        ),
    ]
)


def osborne_2(x: Vector) -> Vector:
    t = np.arange(65) / 10
    bells = sum(x[k + 1] * np.exp(-((t - x[k + 8]) ** 2) * x[k + 5]) for k in range(3))
    return OSBORNE_2 - (x[0] * np.exp(-t * x[4]) + bells)


def _with_rows(function: Callable[..., Vector], m: int) -> Residual:
    return partial(function, m=m)


def _chebyquad(n: int, tries: int, *minima: float) -> Problem:
    start = tuple(float(v) for v in np.arange(1, n + 1) / (n + 1))
    m = max(n, 8)
    return Problem(f"chebyquad-{n}", m, _with_rows(chebyquad, m), start, tries, minima)


def _linear_problems() -> Iterator[Problem]:
    for m in (10, 50):
        yield Problem(
            f"linear-full-rank-{m}", m, _with_rows(linear_full_rank, m), (1.0,) * 5, 1, (m - 5.0,)
        )
        yield Problem(
            f"linear-rank-one-{m}",
            m,
            _with_rows(linear_rank_one, m),
            (1.0,) * 5,
            1,
            (m * (m - 1) / (2 * (2 * m + 1)),),
        )
        yield Problem(
            f"linear-rank-one-zero-borders-{m}",
            m,
            _with_rows(linear_rank_one_zero_borders, m),
            (1.0,) * 5,
            1,
            ((m * m + 3 * m - 6) / (2 * (2 * m - 3)),),
        )


PROBLEMS: tuple[Problem, ...] = (
    *_linear_problems(),
    Problem("rosenbrock", 2, rosenbrock, (-1.2, 1.0), 3, (0.0,)),
    Problem("helical-valley", 3, helical_valley, (-1.0, 0.0, 0.0), 3, (0.0,)),
    Problem("powell-singular", 4, powell_singular, (3.0, -1.0, 0.0, 1.0), 3, (0.0,)),
    Problem("freudenstein-roth", 2, freudenstein_roth, (0.5, -2.0), 3, (0.0, 48.98425)),
    Problem("bard", 15, bard, (1.0, 1.0, 1.0), 3, (8.214877e-3, 17.42869)),
    Problem(
        "kowalik-osborne",
        11,
        kowalik_osborne,
        (0.25, 0.39, 0.415, 0.39),
        3,
        (3.075056e-4, 1.027342e-3),
    ),
    Problem("meyer", 16, meyer, (0.02, 4000.0, 250.0), 2, (87.94586,)),
    Problem("watson-6", 31, watson, (0.0,) * 6, 3, (2.287670e-3,)),
    Problem("watson-9", 31, watson, (0.0,) * 9, 3, (1.399760e-6,)),
    Problem("watson-12", 31, watson, (0.0,) * 12, 3, (4.722381e-10,)),
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
    Problem(
        "osborne-2",
        65,
        osborne_2,
        (1.3, 0.65, 0.65, 0.7, 0.6, 3.0, 5.0, 7.0, 2.0, 4.5, 5.5),
        1,
        (4.013774e-2,),
    ),
)
