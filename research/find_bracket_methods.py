"""Search for the Magnus method with one exponential and eight brackets, of order eight.

    python research/find_bracket_methods.py [FOLDER] [--starts 4] [--seed 6]

A(t) is expanded in Legendre polynomials on the step, with coefficients α_1, ..., α_4 of degrees 1
to 4 in the step size; Lobatto's formula with five nodes integrates all that order eight needs. The
exponent is a combination of α_1, α_3 and brackets that is odd in the step size, so that conditions
of even degree hold: those of Lyndon words of degrees 1, 3, 5 and 7 remain, 22 of them. Each side of
a bracket combines letters and earlier brackets of one parity, as `PATTERN` says. Two starts of each
pattern of four or five brackets came to no solution; with six the bracket of α_2 with seven α_1,
which dominates where A(t) changes little in a step, is left in the error. scipy's least_squares
solves the conditions from random starts, then moves along the set of solutions towards smaller
coefficients of words of degree nine, each times the `SIZES` of its letters. The best solution is
refined.

The second result leaves out the middle node and has the bracket of order four; the third has three
quarters of the method's weights and a quarter of the trapezoidal rule.
"""

import argparse
from decimal import Decimal
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from magnus_series import Array, Numbers, Words, letters_at, lobatto, minimum, written, zero

from cg.construction.catalogue import save
from cg.construction.conditions.linear_equations import Series, as_decimal, bracket, combined, times
from cg.construction.methods.estimate import estimate_ratio
from cg.construction.methods.magnus import MagnusMethod

LETTERS, ORDER = 4, 8
PATTERN = (("odd", "even"), ("odd", "odd"), ("odd", "even"), ("odd", "even"), ("odd", "odd"),
           ("odd", "even"), ("odd", "odd"), ("odd", "even"))  # fmt: skip
"""The parities of both sides of each bracket."""

SIZES = (1, 1 / 2, 1 / 12, 1 / 120)
"""Of Legendre coefficients of a function whose derivatives have equal sizes."""

FACTOR = 4
"""That of the third result."""


class Scheme:
    """The places of the unknowns: weights of both sides of brackets, then those of the exponent."""

    def __init__(self) -> None:
        by_parity = {"odd": [0, 2], "even": [1, 3]}
        self.sides: list[list[int]] = []
        for j, (left, right) in enumerate(PATTERN):
            self.sides += [[*by_parity[left]], [*by_parity[right]]]
            by_parity["even" if left == right else "odd"].append(LETTERS + j)
        self.sides.append(by_parity["odd"])
        self.size = sum(map(len, self.sides))

    def rows(self, unknowns: Any) -> list[list[tuple[int, Any]]]:
        """Return the letters and weights of each side, and of the exponent."""
        at, rows = 0, []
        for side in self.sides:
            rows.append([(letter, unknowns[..., at + i]) for i, letter in enumerate(side)])
            at += len(side)
        return rows


class Search:
    """The conditions in double precision, with the errors of degree nine."""

    def __init__(self) -> None:
        self.scheme = Scheme()
        self.algebra = algebra = Words(LETTERS, ORDER + 1)
        degrees = np.array(list(map(sum, algebra.words)))
        self.low = algebra.conditions(ORDER, odd=True)
        self.high = np.flatnonzero(degrees == ORDER + 1)
        self.logarithm = logarithm(algebra.solution(), ORDER + 1)
        self.exact = np.array([self.logarithm.get(word, 0) for word in algebra.words], np.float64)
        products = [np.prod([SIZES[j - 1] for j in algebra.words[i]]) for i in self.high]
        self.weights = np.array(products)

    def errors(self, unknowns: Array) -> Array:
        """Return the coefficients of words in the exponent less those of the solution."""
        letters: list[Array] = []
        for j in range(LETTERS):
            letters.append(np.zeros(len(self.algebra.words)))
            letters[j][self.algebra.index[(j + 1,)]] = 1.0
        *sides, exponent = self.scheme.rows(unknowns)
        for left, right in zip(sides[::2], sides[1::2], strict=True):
            a, b = (sum(x[..., None] * letters[k] for k, x in side) for side in (left, right))
            letters.append(self.algebra.multiply(a, b) - self.algebra.multiply(b, a))
        return sum(x[..., None] * letters[k] for k, x in exponent) - self.exact

    def size_of(self, unknowns: Array) -> float:
        """Return the error of degree nine."""
        return float(np.linalg.norm(self.weights * self.errors(unknowns)[self.high]))

    def solve(self, unknowns: Array, weight: float, most: int) -> Array:
        """Return a zero of the conditions; with a weight, with a small error of degree nine."""

        def residuals(z: Array) -> Array:
            errors = self.errors(z)
            parts = [errors[..., self.low]]
            if weight:
                parts += [100 * weight * self.weights * errors[..., self.high], 1e-6 * weight * z]
            return np.concatenate(parts, axis=-1)

        return minimum(residuals, unknowns, most, 1e-14)

    def best(self, starts: int, rng: np.random.Generator) -> Array:
        """Return the solution with the smallest error."""
        found: list[Array] = []
        for start in range(starts):
            z = rng.choice([0.3, 1.0, 2.0]) * rng.normal(size=self.scheme.size)
            z = self.solve(z, 0.0, 300)
            if np.abs(self.errors(z)[self.low]).max() > 1e-9:
                continue
            for weight in (20.0, 2.0, 0.2, 0.01, 0.0):
                z = self.solve(z, weight, 25)
            if np.abs(self.errors(z)[self.low]).max() < 1e-9:
                print(f"start {start}: error {self.size_of(z):.4g}", flush=True)
                found.append(z)
        return min(found, key=self.size_of)


def logarithm(series: Series, order: int) -> Series:
    """Return the logarithm of a series whose constant is 1, through a degree."""
    rest = {word: x for word, x in series.items() if word}
    power: Series = {(): 1}
    total: Series = {}
    for n in range(1, order + 1):
        power = times(power, rest, order)
        for word, x in power.items():
            total[word] = total.get(word, 0) - (-1) ** n * x / n
    return total


def refine(unknowns: Array, search: Search) -> Numbers:
    """Return the unknowns to 60 digits."""
    words = [search.algebra.words[i] for i in search.low]

    def of(side: list[tuple[int, Any]], letters: list[Series]) -> Series:
        return combined([x for _, x in side], [letters[k] for k, _ in side])

    def residuals(z: list[Decimal]) -> list[Decimal]:
        letters: list[Series] = [{(j + 1,): 1} for j in range(LETTERS)]
        *sides, exponent = search.scheme.rows(np.array(z, dtype=object))
        for left, right in zip(sides[::2], sides[1::2], strict=True):
            letters.append(bracket(of(left, letters), of(right, letters), ORDER - 1))
        total = of(exponent, letters)
        return [total.get(word, 0) - as_decimal(search.logarithm[word]) for word in words]

    return zero(residuals, unknowns)


def method_of(z: Numbers) -> MagnusMethod:
    """Return the pair that evaluates A at Lobatto's nodes, its coefficients to 36 places."""
    nodes, b = lobatto(LETTERS + 1)
    letters = letters_at(nodes, b, LETTERS)

    def row(side: list[tuple[int, Any]], length: int) -> Numbers:
        entries = [mpmath.mpf(0)] * length
        for letter, weight in side:
            if letter < LETTERS:
                for k, x in enumerate(letters[letter]):
                    entries[k] += weight * x
            else:
                entries[len(nodes) + letter - LETTERS] += weight
        return entries

    *sides, exponent = Scheme().rows(np.array(z, dtype=object))
    brackets = [
        [row(side, len(nodes) + j) for side in sides[2 * j : 2 * j + 2]]
        for j in range(len(PATTERN))
    ]
    rest = [mpmath.mpf(0)] * (len(PATTERN) - 1)
    # the first bracket contains that of α_1 and α_2, which has the weight -1/6 in the exponent
    first = -1 / (6 * z[0] * z[2])
    ends, inner = mpmath.mpf(-1) / 12, mpmath.mpf(7) / 12
    second = [ends, inner, mpmath.mpf(0), inner, ends, first, *rest]
    edge = [0.5, 0, 0, 0, 0.5]
    third = [3 * x / 4 + mpmath.mpf(e) / 4 for x, e in zip(b, edge, strict=True)]
    third += [3 * first / 4, *rest]
    return MagnusMethod(
        written(nodes), [written(row(exponent, len(nodes) + len(PATTERN)))], [written(second)],
        brackets=[[written(side) for side in pair] for pair in brackets], third=written(third),
        third_factor=FACTOR, name="Magnus8(4)",
        source="research/find_bracket_methods.py: one exponential and eight brackets",
    )  # fmt: skip


def main() -> None:
    """Search, refine, print, and write a file if there is a folder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--seed", type=int, default=6)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    search = Search()
    method = method_of(refine(search.best(given.starts, rng), search))
    print(method, f"principal error {method.principal_error:.3g}", end=", ")
    print(f"ratio of error to estimate {estimate_ratio(method):.3g}")
    if given.folder is not None:
        save(method, given.folder)


if __name__ == "__main__":
    main()
