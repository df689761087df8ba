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
coefficients of words of degree nine, each times the `SIZES` of its letters. Newton's method in
multiple precision (mpmath) refines the best solution.

The second result leaves out the middle node and has the bracket of order four; the third has three
quarters of the method's weights and a quarter of the trapezoidal rule.
"""

import argparse
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from find_magnus_methods import Words, lobatto
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cg.catalogue import save
from cg.conditions.linear_equations import Series, times
from cg.method.estimate import estimate_ratio
from cg.method.magnus import MagnusMethod

Array = NDArray[Any]

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
        degrees = np.array([sum(word) for word in algebra.words])
        self.low = [i for i in algebra.lyndon if degrees[i] < ORDER and degrees[i] % 2]
        self.high = np.flatnonzero(degrees == ORDER + 1)
        self.exact = self._logarithm(np.array(algebra.solution(), dtype=np.float64))
        products = [np.prod([SIZES[j - 1] for j in algebra.words[i]]) for i in self.high]
        self.weights = np.array(products)

    def _logarithm(self, series: Array) -> Array:
        rest, total = series - (np.arange(series.size) == 0), np.zeros_like(series)
        power = rest
        for n in range(1, ORDER + 2):
            total = total - (-1) ** n * power / n
            power = self.algebra.multiply(power, rest)
        return total

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

        def jacobian(z: Array) -> Array:
            step = 1e-30
            return (residuals(z + 1j * step * np.eye(z.size)).imag / step).T

        return least_squares(
            residuals, unknowns, jac=jacobian, max_nfev=most, xtol=1e-14, ftol=1e-14, gtol=1e-14
        ).x

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


def refine(unknowns: Array, search: Search) -> list[mpmath.mpf]:
    """Return the unknowns to 60 digits by Newton's method, with changes of least norm."""
    mpmath.mp.dps = 80
    words = [search.algebra.words[i] for i in search.low]
    one: Series = {(): mpmath.mpf(1)}
    series = dict(zip(search.algebra.words, map(_exact, search.algebra.solution()), strict=True))
    rest = {w: x for w, x in series.items() if 0 < sum(w) < ORDER}
    exact: Series = {}
    power = one
    for n in range(1, ORDER):
        power = times(power, rest, ORDER - 1)
        for word, x in power.items():
            exact[word] = exact.get(word, 0) - (-1) ** n * x / n

    def residuals(z: list[mpmath.mpf]) -> list[mpmath.mpf]:
        letters: list[Series] = [{(j + 1,): mpmath.mpf(1)} for j in range(LETTERS)]
        *sides, exponent = search.scheme.rows(np.array(z, dtype=object))
        for left, right in zip(sides[::2], sides[1::2], strict=True):
            a, b = _combined(left, letters), _combined(right, letters)
            ab, ba = times(a, b, ORDER - 1), times(b, a, ORDER - 1)
            letters.append({w: ab.get(w, 0) - ba.get(w, 0) for w in {*ab, *ba}})
        total = _combined(exponent, letters)
        return [total.get(word, 0) - exact[word] for word in words]

    z = [mpmath.mpf(float(x)) for x in unknowns]
    for _ in range(4):
        now, step = residuals(z), mpmath.mpf(10) ** -40
        columns = []
        for j in range(len(z)):
            moved = [x + step * (i == j) for i, x in enumerate(z)]
            columns.append([(b - a) / step for a, b in zip(now, residuals(moved), strict=True)])
        jacobian = mpmath.matrix(columns).T
        normal = mpmath.lu_solve(jacobian * jacobian.T, mpmath.matrix([-x for x in now]))
        z = [x + d for x, d in zip(z, jacobian.T * normal, strict=True)]
    print("largest residual", mpmath.nstr(max(map(abs, residuals(z))), 3))
    return z


def _exact(x: Fraction) -> mpmath.mpf:
    return mpmath.mpf(x.numerator) / x.denominator


def _combined(side: list[tuple[int, Any]], letters: list[Series]) -> Series:
    total: Series = {}
    for letter, weight in side:
        for word, x in letters[letter].items():
            total[word] = total.get(word, 0) + weight * x
    return total


def method_of(z: list[mpmath.mpf]) -> MagnusMethod:
    """Return the pair that evaluates A at Lobatto's nodes, its coefficients to 36 places."""
    nodes, b = lobatto(LETTERS + 1)
    letters = [
        [(2 * j + 1) * w * mpmath.legendre(j, 2 * c - 1) for c, w in zip(nodes, b, strict=True)]
        for j in range(LETTERS)
    ]

    def row(side: list[tuple[int, Any]], length: int) -> list[mpmath.mpf]:
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
        _texts(nodes), [_texts(row(exponent, len(nodes) + len(PATTERN)))], [_texts(second)],
        brackets=[[_texts(side) for side in pair] for pair in brackets], third=_texts(third),
        third_factor=FACTOR, name="Magnus8(4)",
        source="research/find_bracket_methods.py: one exponential and eight brackets",
    )  # fmt: skip


def _texts(row: list[mpmath.mpf]) -> list[str]:
    """Return twelfths as quotients, and other numbers with 36 places."""
    twelfths = [Fraction(int(mpmath.nint(12 * x)), 12) for x in row]
    return [
        str(near) if abs(_exact(near) - x) < mpmath.mpf(10) ** -40
        else mpmath.nstr(mpmath.nint(x * 10**36) / mpmath.mpf(10) ** 36, 38)
        for near, x in zip(twelfths, row, strict=True)
    ]  # fmt: skip


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
