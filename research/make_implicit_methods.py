"""Write the catalogue entries of the implicit methods.

The methods of order four and six are self-adjoint: stages lie on the path of the step,
row r of a is (b_1, ..., b_{r-1}, a_rr), and both b and the offsets a_rr - b_r/2 are
symmetric, the latter with a change of sign. docs/implicit.md derives them. DICG3 is the
best of a random search for one diagonal entry throughout, DICG3(2) a rational pair of
that kind.

    python research/make_implicit_methods.py FOLDER [NAME ...]
"""

from collections.abc import Sequence
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
from recipes import run

from cg.construction.candidate import Candidate
from cg.construction.layouts.layout import Layout, Rows
from cg.construction.methods.packed import make_method
from cg.construction.methods.tableau import Tableau
from cg.construction.optimise import Goals, optimise
from cg.construction.search.start import random_start
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.polish import polish
from cg.construction.solvers.system import ConditionSystem

DIGITS = 36
SEED, STARTS = 1, 20
YOSHIDA = (0.784513610477560, 0.235573213359357, -1.17767998417887)


def on_path(b: Sequence[Fraction], diagonal: Sequence[Fraction]) -> list[list[Fraction]]:
    """Return the rows of a whose stages lie on the path of the step."""
    return [[*b[:r], entry] for r, entry in enumerate(diagonal)]


def midpoints(outer: Sequence[Fraction], order: int, **names: str) -> Tableau:
    """Compose implicit midpoint steps of lengths ``outer``, 1 - 2 Σ outer, ``outer`` reversed."""
    near = [Fraction(gamma) for gamma in outer]
    stages, size = 2 * len(near) + 1, len(near)

    def packed(lengths: Sequence[Fraction]) -> list[Fraction]:
        b = [*lengths, 1 - 2 * sum(lengths, Fraction()), *reversed(lengths)]
        rows = on_path(b, [gamma / 2 for gamma in b])
        return [entry for row in (*rows, b) for entry in row]

    offset = np.array(packed([Fraction()] * size), dtype=np.float64)
    unit = [[Fraction(i == j) for j in range(size)] for i in range(size)]
    directions = np.array([packed(u) for u in unit], dtype=np.float64).T - offset[:, None]
    polished = polish(
        packed(near), ConditionSystem.tableau(order, stages, Rows.DIAGONAL), directions=directions
    )
    if polished.largest_residual > Fraction(1, 10**43):
        raise RuntimeError(f"residuals are still {float(polished.largest_residual):.1e}")
    return make_method(Layout.tableau(stages, Rows.DIAGONAL), polished.x, digits=DIGITS, **names)


def rational() -> Tableau:
    """Return DICG4b."""
    b = [Fraction(5, 12), Fraction(5, 12), Fraction(-2, 3), Fraction(5, 12), Fraction(5, 12)]
    diagonal = [Fraction(k, 60) for k in (12, 11, -20, 14, 13)]
    return Tableau(
        on_path(b, diagonal),
        b,
        name="DICG4b",
        source="Self-adjoint, stages on the path of the step; a rational point of the conic that "
        "the conditions of order four leave for the diagonal",
    )


def l_stable() -> Tableau:
    """Return DICG3: the diagonal entry makes it L-stable, the rest a small principal error."""
    with localcontext() as context:
        context.prec = 50
        gamma = Decimal("0.4358665215")
        for _ in range(6):  # Newton's method
            value = gamma**3 - 3 * gamma**2 + Decimal("1.5") * gamma - 1 / Decimal(6)
            gamma -= value / (3 * gamma**2 - 6 * gamma + Decimal("1.5"))
    rows, stages, order = Rows.DIAGONAL, 3, 3
    system = ConditionSystem.tableau(order, stages, rows)
    ends = np.array([system.layout.row(stage)[-1] for stage in range(stages)])
    movable = np.setdiff1d(np.arange(system.size), ends)
    candidates = []
    for index in range(STARTS):
        guess = random_start(SEED, index, system.size, 1.0)
        guess[ends] = float(gamma)
        fit = fit_conditions(guess, system, movable=movable)
        if fit.f < 1e-25:
            candidates.append(
                optimise(Candidate(system, fit.x), Goals(), frozen=ends, tolerance=1e-12)
            )
    best = min(candidates, key=lambda candidate: candidate.principal_error)
    near = [Fraction(entry) for entry in best.x]
    for end in ends:
        near[end] = Fraction(round(Fraction(gamma) * 10**DIGITS), 10**DIGITS)
    polished = polish(near, system, directions=np.eye(system.size)[:, movable])
    return make_method(
        Layout.tableau(stages, rows),
        polished.x,
        digits=DIGITS,
        name="DICG3",
        source="Search with one diagonal entry, the root 0.4358665... of x^3 - 3x^2 + 3x/2 - 1/6 "
        "(L-stable where flows commute); smallest principal error along the solutions",
    )


def damped_pair() -> Tableau:
    """Return DICG3(2).

    It is stiffly accurate with the diagonal entry 1/4, which makes it L-stable. With the
    abscissae 1/4, x, y and 1 the conditions but one give b; the last one is a curve in (x, y),
    and (11/20, 7/15) a rational point of it with small denominators. Of the second weights all
    are damped as well that have order two and vanish at infinity: those of the line through b
    on which the last one is free.
    """
    b = [Fraction(1, 3), Fraction(-1, 3), Fraction(3, 4), Fraction(1, 4)]
    a = [
        [Fraction(1, 4)],
        [Fraction(3, 10), Fraction(1, 4)],
        [Fraction(409, 1080), Fraction(-35, 216), Fraction(1, 4)],
        b,
    ]
    along = [Fraction(13, 42), Fraction(-235, 42), Fraction(30, 7), Fraction(1)]
    second = [weight - direction / 10 for weight, direction in zip(b, along, strict=True)]
    return Tableau(
        a,
        b,
        b_embedded=second,
        name="DICG3(2)",
        source="Stiffly accurate with the diagonal entry 1/4 (L-stable where flows commute, as are "
        "the second weights); a rational point of the curve that the conditions of order three "
        "leave for the abscissae",
    )


def methods() -> list[Tableau]:
    """Return all of them."""
    midpoint = Tableau(
        [["1/2"]],
        ["1"],
        name="ImplicitMidpoint",
        source="The implicit midpoint rule with flows of the frame in place of straight lines",
    )
    outer = 1 / (2 - 2 ** (1 / 3))
    triple = midpoints(
        [Fraction(outer)],
        4,
        name="DICG4",
        source="Three implicit midpoint steps of lengths 1/(2 - 2^(1/3)), 1 - 2/(2 - 2^(1/3)), "
        "1/(2 - 2^(1/3)); the one diagonally implicit method of three stages that a search finds",
    )
    with localcontext() as context:
        context.prec = 50  # one of a family, along which an error isn't corrected
        inner = Fraction(1 / (4 - Decimal(4) ** (1 / Decimal(3))))
    five = midpoints(
        [inner, inner],
        4,
        name="DICG4c",
        source="Five implicit midpoint steps of lengths g, g, 1 - 4g, g, g with g = "
        "1/(4 - 4^(1/3)), by M. Suzuki: Fractal decomposition of exponential operators with "
        "applications to many-body theories and Monte Carlo simulations. Phys. Lett. A 146 (1990) "
        "319–323",
    )
    seven = midpoints(
        [Fraction(gamma) for gamma in YOSHIDA],
        6,
        name="DICG6",
        source="Seven implicit midpoint steps of lengths by H. Yoshida: Construction of higher "
        "order symplectic integrators. Phys. Lett. A 150 (1990) 262–268, solution A; refined to "
        "36 digits",
    )
    return [midpoint, l_stable(), damped_pair(), triple, rational(), five, seven]


if __name__ == "__main__":
    METHODS = {method.name: method for method in methods()}
    run(METHODS.__getitem__, METHODS, __doc__)
