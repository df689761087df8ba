"""Make the splitting methods of the catalogue from published coefficients.

    python research/make_splitting_methods.py FOLDER [NAME ...]

Methods are symmetric: the first half of drifts and kicks is given, with the digits printed. As many
coefficients as the order conditions determine, chosen by a QR decomposition with pivoting of their
Jacobian, are solved for by the Gauss-Newton method with 60 digits (mpmath); the others are kept as
printed. The sums of drifts and of kicks are conditions like others. Coefficients are stored with 36
places.
"""

from decimal import Decimal
from typing import Any

import mpmath
import numpy as np
from recipes import run
from scipy.linalg import qr

from cg.construction.conditions.nystrom import nystrom_residuals
from cg.construction.methods.splitting import Splitting

BLANES_MOAN = (
    "S. Blanes, P. C. Moan: Practical symplectic partitioned Runge–Kutta and Runge–Kutta–Nyström "
    "methods. J. Comput. Appl. Math. 142 (2002) 313–330, "
)
PRINTED: dict[str, tuple[int, str, str, str]] = {
    "BlanesMoan4": (
        4,
        "0 0.245298957184271 0.604872665711080",
        "0.0829844064174052 0.396309801498368 -0.0390563049223486",
        BLANES_MOAN + "order four, six stages, b",
    ),
    "BlanesMoan6": (
        6,
        "0 0.123229775946271 0.290553797799558 -0.127049212625417 -0.246331761062075 "
        "0.357208872795928",
        "0.0414649985182624 0.198128671918067 -0.0400061921041533 0.0752539843015807 "
        "-0.0115113874206879",
        BLANES_MOAN + "order six, eleven stages, b",
    ),
    "BlanesCasas8": (
        8,
        "0 0.160227696073839513690970240076 0.306354507436867319879440957100 "
        "0.308395508895171191756544975556 0.120362086566233408450063177659 "
        "-0.622888687549183872072186218718 0.635560951632990078378672016548 "
        "-0.144226974795419229640437363913 -0.284867527074173816678992817545",
        "0.0514196142537210073343152693459 0.250497030318342871458417941091 "
        "0.512412268300327350035492806653 -0.231597138650894401279645184364 "
        "0.116091323536875759881216298975 -0.0098365173246965763985763034283 "
        "-0.108032771466281638634277563747 0.249039864198023642002940910070",
        "S. Blanes, F. Casas, A. Escorihuela-Tomàs: Runge–Kutta–Nyström symplectic splitting "
        "methods of order 8. arXiv 2202.01541 (2022), seventeen stages, B",
    ),
}
"""Order, first halves of drifts and kicks without the middle ones, and source."""

NAMES = ["Leapfrog", "McLachlan2", *PRINTED]
_MIDDLE = 1e6  # factor on columns of the Jacobian: middle coefficients are solved for
_RANK = 1e-9  # relative size of pivots that count


def make(name: str) -> Splitting:
    """Return the method with a name."""
    mpmath.mp.dps = 60
    if name == "Leapfrog":
        source = (
            "L. Verlet: Computer experiments on classical fluids. I. Phys. Rev. 159 (1967) 98–103; "
            "the form with velocities, which begins and ends with a kick"
        )
        return Splitting([0, 1, 0], ["1/2", "1/2"], name=name, source=source)
    if name == "McLachlan2":
        # the errors are (1 - 6ξ + 6ξ²)/12 [T, [T, V]] and (1 - 6ξ)/24 [V, [T, V]]; ξ minimises the
        # sum of their squares
        xi = mpmath.findroot(lambda x: 48 * x**3 - 72 * x**2 + 38 * x - 5, 0.19)
        source = (
            "R. I. McLachlan: On the numerical integration of ordinary differential equations by "
            "symmetric composition methods. SIAM J. Sci. Comput. 16 (1995) 151–168; the minimiser "
            "also of I. P. Omelyan, I. M. Mryglod, R. Folk, Phys. Rev. E 65 (2002) 056706"
        )
        drifts = texts([xi, 1 - 2 * xi, xi])
        return Splitting(drifts, ["1/2", "1/2"], name=name, source=source)
    order, *rows, source = PRINTED[name]
    halves = [list(map(mpmath.mpf, row.split())) for row in rows]
    singles = [len(halves[0]) > len(halves[1]), len(halves[0]) == len(halves[1])]
    for half, single in zip(halves, singles, strict=True):
        total = mpmath.fsum(half)
        half.append(1 - 2 * total if single else 0.5 - total)
    solved = map(texts, solve(halves, singles, order))
    return Splitting(*solved, name=name, source=source)


def solve(halves: list[list[Any]], singles: list[bool], order: int) -> list[list[Any]]:
    """Return drifts and kicks that satisfy the order conditions, near the palindromes of halves.

    `singles` tells of both if the middle one occurs once.
    """
    point, first = halves[0] + halves[1], len(halves[0])

    def whole(point: list[Any]) -> list[list[Any]]:
        parts = zip((point[:first], point[first:]), singles, strict=True)
        return [half + half[::-1][single:] for half, single in parts]

    def residuals(point: list[Any]) -> list[Any]:
        return nystrom_residuals(*whole(point), order)

    def derivatives(here: list[Any], j: int) -> list[Any]:
        """Return differences of the residuals here; zeros for a coefficient that is zero."""
        step = mpmath.mpf(10) ** -(mpmath.mp.dps // 2) * (point[j] != 0)
        moved = residuals([x + step * (k == j) for k, x in enumerate(point)])
        return [(b - a) / (step or 1) for a, b in zip(here, moved, strict=True)]

    here = residuals(point)
    columns = np.array([derivatives(here, j) for j in range(len(point))], dtype=float)
    columns[[first - 1, -1]] *= _MIDDLE
    triangle, pivots = qr(columns.T, mode="r", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    chosen = pivots[: np.count_nonzero(sizes > _RANK * sizes.max() / _MIDDLE)].tolist()
    for _ in range(3):  # the printed digits are doubled each time
        jacobian = mpmath.matrix([derivatives(here, j) for j in chosen]).T
        change = mpmath.lu_solve(jacobian, -mpmath.matrix(here))
        for j, value in zip(chosen, change, strict=True):
            point[j] += value
        here = residuals(point)
    largest = max(map(abs, here))
    print(f"{len(chosen)} of {len(point)} solved for, residuals {mpmath.nstr(largest, 2)}")
    return whole(point)


def texts(row: list[Any]) -> list[str]:
    """Return numbers with 36 places; fewer would count as less exact."""
    return [str(Decimal(f"{int(mpmath.nint(x * 10**36))}e-36")) if x else "0" for x in row]


if __name__ == "__main__":
    run(make, NAMES, __doc__)
