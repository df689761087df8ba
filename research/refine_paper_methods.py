"""Write the catalogue entries of the paper's methods, with 36 digits where they can be had.

The paper prints CG4a and CG5a with 16 digits. From there minimum-norm Gauss–Newton steps
lead to a nearby exact solution of the order conditions: residuals in rational arithmetic,
corrections by the pseudo-inverse of the Jacobian in double precision. This converges
linearly, by some thirteen digits a step. Coefficients that are printed as zero stay zero.
CG4 has closed forms; CG6a is kept as printed, since no exact solution is near.

    python research/refine_paper_methods.py FOLDER [NAME ...]
"""

from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
from recipes import run

from cg.construction.layouts.layout import Layout
from cg.construction.methods.packed import make_method
from cg.construction.methods.tableau import Tableau
from cg.construction.solvers.polish import polish
from cg.construction.solvers.system import ConditionSystem
from cg.reproduce.appendix_a import Printed, printed

PAPER = (
    "Z. Jackiewicz, A. Marthinsen, B. Owren: Construction of Runge–Kutta methods of "
    "Crouch–Grossman type of high order. Adv. Comput. Math. 13 (2000) 405–415, Appendix A"
)
CG4_SOURCE = (
    "B. Owren, A. Marthinsen: Runge–Kutta methods adapted to manifolds and based on rigid "
    "frames. BIT 39 (1999) 116–142; 36 digits of the closed form"
)


def refined(paper: Printed, order: int, source: str) -> Tableau:
    """Return the exact method close to the printed coefficients, whose zeros are held."""
    x = [Fraction(entry) for row in (*paper.a, paper.b) for entry in row]
    movable = [k for k, entry in enumerate(x) if entry != 0]
    system = ConditionSystem.tableau(order, len(paper.b))
    polished = polish(x, system, directions=np.eye(len(x))[:, movable])
    layout = Layout.tableau(len(paper.b))
    return make_method(layout, polished.x, digits=36, name=paper.name, source=source)


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


def make(name: str) -> Tableau:
    """Return CG4, CG4a, CG5a or CG6a."""
    if name == "CG4":
        return owren_marthinsen()
    paper = printed()[name]
    if name == "CG6a":
        return Tableau(
            paper.a,
            paper.b,
            name=name,
            source=f"{PAPER}, Example 3, as printed",
            nominal_order=6,
            nominal_residual="0.00001",
        )
    order = {"CG4a": 4, "CG5a": 5}[name]
    return refined(paper, order, f"{PAPER}, Example {order - 3}; refined to 36 digits")


if __name__ == "__main__":
    run(make, ["CG4", "CG4a", "CG5a", "CG6a"], __doc__)
