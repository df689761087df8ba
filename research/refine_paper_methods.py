"""Write the catalogue entries of the paper's methods, with 36 digits where they can be had.

The paper prints CG4a and CG5a with 16 digits. From there minimum-norm Gauss–Newton steps
lead to a nearby exact solution of the order conditions: residuals in rational arithmetic,
corrections by the pseudo-inverse of the Jacobian in double precision. This converges
linearly, by some thirteen digits a step. Coefficients that are printed as zero stay zero.
CG4 has closed forms; CG6a is kept as printed, since no exact solution is near.

    python research/refine_paper_methods.py [FOLDER]
"""

from __future__ import annotations

import sys
from decimal import Decimal, localcontext
from fractions import Fraction
from pathlib import Path

import numpy as np

from cg import conditions
from cg.catalogue import save
from cg.method.packed import make_method
from cg.method.tableau import Tableau
from cg.reproduce.appendix_a import Printed, printed
from cg.structure.layout import Layout

PAPER = (
    "Z. Jackiewicz, A. Marthinsen, B. Owren: Construction of Runge–Kutta methods of "
    "Crouch–Grossman type of high order. Adv. Comput. Math. 13 (2000) 405–415, Appendix A"
)
CG4_SOURCE = (
    "B. Owren, A. Marthinsen: Runge–Kutta methods adapted to manifolds and based on rigid "
    "frames. BIT 39 (1999) 116–142; 36 digits of the closed form"
)
GRID = 10**60  # iterates are multiples of 1/GRID
ENOUGH = Fraction(1, 10**48)
RANK_CUT = 1e-10  # singular values of CG5a: 3e-4, then 7e-16


def refined(paper: Printed, order: int) -> list[Fraction]:
    """Return packed coefficients near the printed ones whose residuals are below `ENOUGH`."""
    stages = len(paper.b)
    x = [Fraction(entry) for row in (*paper.a, paper.b) for entry in row]
    free = [k for k, entry in enumerate(x) if entry != 0]
    a, b = conditions.unpack([float(entry) for entry in x], stages)
    jacobian = conditions.jacobian(a, b, order, independent=True)
    inverse = np.linalg.pinv(jacobian[:, free], rcond=RANK_CUT)
    for _ in range(10):
        residuals = conditions.residuals_exact(
            *conditions.unpack(x, stages), order, independent=True
        )
        size = max(map(abs, residuals))
        if size < ENOUGH:
            return x
        correction = inverse @ [float(residual / size) for residual in residuals]
        for k, step in zip(free, correction, strict=True):
            x[k] -= Fraction(round(Fraction(step) * size * GRID), GRID)
    raise RuntimeError(f"{paper.name}: residuals are still {float(size):.1e}")


def owren_marthinsen() -> Tableau:
    """Return CG4 from its closed form, in the notation of its authors."""
    with localcontext(prec=60):
        root = Decimal(2) ** (Decimal(1) / 3)
        square = root * root
        t1, t2, t3, t4 = (
            1 + root + square,
            root + square,
            2 * root + square,
            4 + 3 * root + 2 * square,
        )
        theta = (t1 + (105 + 88 * root + 71 * square).sqrt()) / 18
        third = root / 3 + square / 6
        c = [Decimal(3) / 2, third + Decimal(2) / 3, Decimal(1) / 3 - third, Decimal(1)]
        inner = [
            [],
            [t4 / 18],
            [t1 * theta - t4 / 18, (3 + t2 - 9 * t1 * theta) / (4 + t3)],
            [theta, (3 + 2 * t2 - 9 * t1 * theta) / (10 + 8 * root + 7 * square), -t2 / (4 + t3)],
        ]
        outer = t1 / (2 * t2)
        b = [outer, Decimal(0), -(1 + t3) / (6 * (2 + t2)), -1 / (2 * t2), outer]
        rows = [[end - sum(row), *row] for end, row in zip(c, inner, strict=True)]
    packed = [Fraction(entry) for row in (*rows, b) for entry in row]
    return make_method(Layout.tableau(5), packed, digits=36, name="CG4", source=CG4_SOURCE)


def main(folder: Path) -> None:
    """Write CG4, CG4a, CG5a and CG6a into `folder`."""
    found = [owren_marthinsen()]
    for name, order, example in (("CG4a", 4, 1), ("CG5a", 5, 2)):
        paper = printed()[name]
        source = f"{PAPER}, Example {example}; refined to 36 digits"
        x = refined(paper, order)
        layout = Layout.tableau(len(paper.b))
        found.append(make_method(layout, x, digits=36, name=name, source=source))
    paper = printed()["CG6a"]
    found.append(
        Tableau(
            paper.a,
            paper.b,
            name="CG6a",
            source=f"{PAPER}, Example 3, as printed",
            nominal_order=6,
            nominal_residual="0.00001",
        )
    )
    for method in found:
        save(method, folder / f"{method.name}.toml")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "cg/catalogue"))
