"""Write the methods of two registers that are solutions of order conditions to 36 digits.

A method with two registers, Z_i = A_i Z_{i-1} + F_i and y_i = exp(h B_i Z_i) y_{i-1}, is a chain of
points. Of CF4b, Carpenter and Kennedy's five-stage method, the rationals in print satisfy the
conditions of order four to 5e-26 only; of the others A and B are known in double precision. They
are moved to the closest solution with two registers, by corrections of least norm in A and B whose
residuals are exact.

    python research/make_two_register_methods.py FOLDER [NAME ...]
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from recipes import run

from cg import conditions
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.low_storage import from_two_registers
from cg.construction.solvers.polish import refine_rational
from cg.construction.solvers.singular import pseudo_inverse
from cg.support.quads import to_decimal

FOUND = (
    "found by a search of this project: a chain of two registers from a random start in A and B, "
    "order conditions on manifolds, least principal error nearby; 36 digits"
)


class Start(NamedTuple):
    """A method to some digits; A is without A_1, which has no effect."""

    order: int
    a: tuple[str, ...]
    b: tuple[str, ...]
    source: str


STARTS = {
    "CF4b": Start(
        4,
        (
            "-567301805773/1357537059087",
            "-2404267990393/2016746695238",
            "-3550918686646/2091501179385",
            "-1275806237668/842570457699",
        ),
        (
            "1432997174477/9575080441755",
            "5161836677717/13612068292357",
            "1720146321549/2090206949498",
            "3134564353537/4481467310338",
            "2277821191437/14882151754819",
        ),
        "M. H. Carpenter, C. A. Kennedy: Fourth-order 2N-storage Runge–Kutta schemes. NASA "
        "TM-109112 (1994), five stages; its rationals moved to the closest solution with two "
        "registers and 36 digits. As a commutator-free method: A. Bazavov, arXiv:2007.04225",
    ),
    "CF5r": Start(
        5,
        (
            "-0.605056024890579",
            "-1.29654292001734",
            "-1.13439036362692",
            "-0.512567957358993",
            "-1.88485642276083",
            "-0.659229254800269",
            "-1.61940745790311",
            "-0.732990781942359",
            "-0.930255900036872",
            "-1.64621671895256",
        ),
        (
            "0.176914241109247",
            "0.49623173756094",
            "0.470539532255477",
            "0.263962024762889",
            "0.285851373896825",
            "0.178752314127565",
            "-0.293970873639043",
            "0.301209361744407",
            "0.00501170233036291",
            "-0.357258332610193",
            "0.283231589816821",
        ),
        FOUND,
    ),
}
ENOUGH = Fraction(1, 10**44)
RANK_CUT = 1e-9  # singular values below this fraction of the largest count as zero


def method_of(start: Start, parameters: Sequence[Fraction]) -> CommutatorFree:
    """Return the method with given A and B."""
    first = len(start.a)
    return from_two_registers([Fraction(0), *parameters[:first]], parameters[first:])


def derivatives(start: Start, parameters: Sequence[Fraction]) -> NDArray[np.float64]:
    """Return the derivatives of the residuals by A and B; shape (conditions, parameters)."""
    here = method_of(start, parameters)
    columns = []
    for k in range(len(parameters)):
        # weights are products of parameters, each to the power of one at most
        there = method_of(start, [p + (j == k) for j, p in enumerate(parameters)])
        pairs = zip(there.coefficients, here.coefficients, strict=True)
        columns.append([float(new.value - old.value) for new, old in pairs])
    x = np.array([float(weight.value) for weight in here.coefficients])
    return conditions.jacobian(here.layout, x, start.order, independent=True) @ np.array(columns).T


def make(name: str) -> CommutatorFree:
    """Return the closest exact method, and say how far weights are from those at the start."""
    start = STARTS[name]
    parameters = list(map(Fraction, (*start.a, *start.b)))
    inverse, _ = pseudo_inverse(derivatives(start, parameters), RANK_CUT)

    def residuals(parameters: Sequence[Fraction]) -> Sequence[Fraction]:
        method = method_of(start, parameters)
        return conditions.residuals(method, start.order, independent=True, arithmetic="exact")

    end = refine_rational(residuals, parameters, inverse)
    if end.largest_residual > ENOUGH:
        raise RuntimeError(f"residuals are still {float(end.largest_residual):.1e}")
    exact, known = method_of(start, end.x), method_of(start, parameters)
    rounded = [
        (point.parent, {k: to_decimal(weight) for k, weight in point.weights.items()})
        for point in exact.points
    ]
    pairs = zip(exact.coefficients, known.coefficients, strict=True)
    moved = max(abs(float(new.value - old.value)) for new, old in pairs)
    print(f"{name}: weights moved by at most {moved:.1e}")
    return CommutatorFree(rounded, exact.stage_points, name=name, source=start.source)


if __name__ == "__main__":
    run(make, STARTS, __doc__)
