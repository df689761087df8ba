"""Write CF4b, Carpenter and Kennedy's five-stage method, with the digits that it lacks in print.

A method with two registers, Z_i = A_i Z_{i-1} + F_i and y_i = exp(h B_i Z_i) y_{i-1}, is a chain of
points. The rationals in print satisfy the conditions of order four to 5e-26 only. They are moved to
the closest solution with two registers, by corrections of least norm in A and B whose residuals
are exact.

    python tools/make_two_register_methods.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cg.catalogue import save
from cg.commutator_free import CommutatorFree
from cg.conditions import exact_residuals_of, jacobian_at
from cg.quad import to_decimal

ORDER = 4
A = (
    "-567301805773/1357537059087",
    "-2404267990393/2016746695238",
    "-3550918686646/2091501179385",
    "-1275806237668/842570457699",
)
B = (
    "1432997174477/9575080441755",
    "5161836677717/13612068292357",
    "1720146321549/2090206949498",
    "3134564353537/4481467310338",
    "2277821191437/14882151754819",
)
SOURCE = (
    "M. H. Carpenter, C. A. Kennedy: Fourth-order 2N-storage Runge–Kutta schemes. NASA TM-109112 "
    "(1994), five stages; its rationals moved to the closest solution with two registers and 36 "
    "digits. As a commutator-free method: A. Bazavov, arXiv:2007.04225"
)
GRID = 10**60  # parameters are multiples of 1/GRID, so that they don't grow
ENOUGH = Fraction(1, 10**44)
RANK_CUT = 1e-9  # singular values below this fraction of the largest count as zero


def two_registers(a: Sequence[Fraction], b: Sequence[Fraction]) -> CommutatorFree:
    """Return the method of two registers; `a` lacks A_1, which multiplies nothing."""
    register: list[Fraction] = []
    points = []
    for i, factor in enumerate(b):
        register = [*(a[i - 1] * weight for weight in register), Fraction(1)]
        points.append((i - 1, {k: factor * weight for k, weight in enumerate(register)}))
    return CommutatorFree(points, range(-1, len(b) - 1))


def derivatives(a: Sequence[Fraction], b: Sequence[Fraction]) -> NDArray[np.float64]:
    """Return the derivatives of all weights by A and B; shape (weights, parameters)."""
    parameters = [*a, *b]
    here = two_registers(a, b)
    columns = []
    for k in range(len(parameters)):
        # weights are products of parameters, each to the power of one at most
        moved = [p + (j == k) for j, p in enumerate(parameters)]
        there = two_registers(moved[: len(a)], moved[len(a) :])
        pairs = zip(there.coefficients, here.coefficients, strict=True)
        columns.append([float(new.value - old.value) for new, old in pairs])
    return np.array(columns).T


def closest(a: Sequence[Fraction], b: Sequence[Fraction], order: int) -> CommutatorFree:
    """Return the exact method of this order close to given parameters."""
    parameters = [*a, *b]
    for _ in range(10):
        a, b = parameters[: len(a)], parameters[len(a) :]
        method = two_registers(a, b)
        residuals = exact_residuals_of(method, order, independent=True)
        size = max(map(abs, residuals))
        if size < ENOUGH:
            return method
        x = np.array([float(weight.value) for weight in method.coefficients])
        slopes = jacobian_at(method.layout, x, order, independent=True) @ derivatives(a, b)
        step = np.linalg.pinv(slopes, rcond=RANK_CUT) @ [float(r / size) for r in residuals]
        parameters = [
            p - Fraction(round(Fraction(move) * size * GRID), GRID)
            for p, move in zip(parameters, step.tolist(), strict=True)
        ]
    raise RuntimeError(f"residuals are still {float(size):.1e}")


def main(folder: Path) -> None:
    """Write the file and say how far its weights are from those in print."""
    a, b = list(map(Fraction, A)), list(map(Fraction, B))
    printed, found = two_registers(a, b), closest(a, b, ORDER)
    rounded = [
        (point.parent, {k: to_decimal(weight) for k, weight in point.weights.items()})
        for point in found.points
    ]
    method = CommutatorFree(rounded, found.stage_points, name="CF4b", source=SOURCE)
    save(method, folder / f"{method.name}.toml")
    pairs = zip(method.coefficients, printed.coefficients, strict=True)
    moved = max(abs(float(new.value - old.value)) for new, old in pairs)
    print(f"{method.name}: order {method.order}, weights moved by at most {moved:.1e}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "cg/catalogue"))
