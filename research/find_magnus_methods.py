"""Search for the commutator-free Magnus methods of orders six and eight, and write their files.

    python research/find_magnus_methods.py ORDER FLOWS [FOLDER] [--symmetric] [--seed N]

``6 4`` finds four flows for order six, ``8 8 --symmetric`` eight flows for order eight. A(t) is
expanded in K = ORDER/2 Legendre polynomials on the step; Lobatto's formula with K + 1 nodes
integrates all that the order needs. With x_ij the weight of polynomial j in exponential i, the
order conditions are those of Lyndon words in K letters of degrees 1 to K (of odd degree, if the
method is symmetric). scipy's least_squares solves them from random starts; Newton's method in
multiple precision (mpmath) refines the solution with the smallest Σ|x_i1|.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from fractions import Fraction
from math import factorial
from pathlib import Path

import mpmath
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cg.catalogue import save
from cg.conditions.linear import product_of_exponentials
from cg.conditions.linear import words as all_words
from cg.method.magnus import MagnusMethod
from cg.trees.ordered import is_lyndon

Array = NDArray[np.float64]
Word = tuple[int, ...]


def conditions(words: Sequence[Word], symmetric: bool) -> list[Word]:
    """Return the words of the order conditions: Lyndon words, of odd degree if symmetric."""
    return [w for w in words if is_lyndon(w) and (not symmetric or sum(w) % 2)]


def solution(word: Word) -> Fraction:
    """Return the coefficient of a word in the solution, letters being Legendre polynomials."""
    inner = [Fraction(1)]
    for j in reversed(word):
        integrand = [Fraction(0)] * (len(inner) + j)
        for a, u in enumerate(inner):
            for b, v in enumerate(_legendre(j - 1)):
                integrand[a + b] += u * v
        inner = [Fraction(0), *(c / (k + 1) for k, c in enumerate(integrand))]
    return sum(inner, Fraction(0))


def _legendre(degree: int) -> list[Fraction]:
    """Return the coefficients of the Legendre polynomial of 2θ - 1."""
    return [
        Fraction(
            (-1) ** (degree + k) * factorial(degree + k), factorial(k) ** 2 * factorial(degree - k)
        )
        for k in range(degree + 1)
    ]


def expand(free: Array, flows: int, letters: int, symmetric: bool) -> Array:
    """Return x, shape (..., flows, letters), from its free entries."""
    if not symmetric:
        return free.reshape(*free.shape[:-1], flows, letters)
    half = free.reshape(*free.shape[:-1], flows // 2, letters)
    signs = (-1) ** np.arange(letters)
    return np.concatenate([half, half[..., ::-1, :] * signs], axis=-2)


def search(order: int, flows: int, symmetric: bool, starts: int, seed: int) -> Array | None:
    """Return the free entries of the solution with the smallest Σ|x_i1|; None without any."""
    letters = order // 2
    words = [word for word in all_words(order) if max(word) <= letters]
    rows = conditions(words, symmetric)
    exact = np.array([float(solution(word)) for word in rows])
    size = flows * letters // (2 if symmetric else 1)

    def residuals(free: Array) -> Array:
        x = np.moveaxis(expand(free, flows, letters, symmetric), (-2, -1), (0, 1))
        weights = product_of_exponentials(x, words)
        return np.stack([weights[word] for word in rows], axis=-1) - exact

    def jacobian(free: Array) -> Array:
        step = 1e-30
        return (residuals(free + 1j * step * np.eye(size)).imag / step).T

    random, best = np.random.default_rng(seed), None
    for k in range(starts):
        fit = least_squares(
            residuals, random.uniform(-0.6, 0.8, size), jac=jacobian, max_nfev=200,
            xtol=1e-15, ftol=1e-15, gtol=1e-15,
        )  # fmt: skip
        if np.abs(fit.fun).max() < 1e-11:
            length = np.abs(expand(fit.x, flows, letters, symmetric)[:, 0]).sum()
            print(f"start {k}: sum of |x_i1| {length:.4f}", flush=True)
            if best is None or length < best[0] - 1e-9:
                best = length, fit.x
    return None if best is None else best[1]


def refine(free: Array, order: int, flows: int, symmetric: bool) -> list[list[mpmath.mpf]]:
    """Return x to 60 digits by the Gauss–Newton method, with differences for the Jacobian."""
    mpmath.mp.dps = 80
    letters = order // 2
    words = [word for word in all_words(order) if max(word) <= letters]
    rows = conditions(words, symmetric)
    exact = [mpmath.mpf(c.numerator) / c.denominator for c in map(solution, rows)]

    def x_of(free: list[mpmath.mpf]) -> list[list[mpmath.mpf]]:
        x = [free[letters * i : letters * (i + 1)] for i in range(len(free) // letters)]
        mirrored = [[(-1) ** j * v for j, v in enumerate(row)] for row in reversed(x)]
        return x + mirrored if symmetric else x

    def residuals(free: list[mpmath.mpf]) -> list[mpmath.mpf]:
        weights = product_of_exponentials(x_of(free), words)
        return [weights[word] - side for word, side in zip(rows, exact, strict=True)]

    point = [mpmath.mpf(float(v)) for v in free]
    for _ in range(5):
        now, step = residuals(point), mpmath.mpf(10) ** -40
        columns = []
        for j in range(len(point)):
            moved = [v + step * (i == j) for i, v in enumerate(point)]
            columns.append([(b - a) / step for a, b in zip(now, residuals(moved), strict=True)])
        change = mpmath.lu_solve(mpmath.matrix(columns).T, mpmath.matrix([-v for v in now]))
        point = [v + d for v, d in zip(point, change, strict=True)]
    print("largest residual", mpmath.nstr(max(map(abs, residuals(point))), 3))
    return x_of(point)


def lobatto(count: int) -> tuple[list[mpmath.mpf], list[mpmath.mpf]]:
    """Return Lobatto's nodes and weights on [0, 1]."""
    derivative: Callable[[mpmath.mpf], mpmath.mpf] = lambda x: mpmath.diff(  # noqa: E731
        lambda t: mpmath.legendre(count - 1, t), x
    )
    inner = [
        mpmath.findroot(derivative, mpmath.mpf(float(root)))
        for root in np.polynomial.Legendre.basis(count - 1).deriv().roots()
    ]
    nodes = [mpmath.mpf(-1), *sorted(inner), mpmath.mpf(1)]
    weights = [1 / (count * (count - 1) * mpmath.legendre(count - 1, x) ** 2) for x in nodes]
    return [(x + 1) / 2 for x in nodes], weights


def method_of(x: list[list[mpmath.mpf]], name: str) -> MagnusMethod:
    """Return the method that evaluates A at Lobatto's nodes, its coefficients to 36 places."""
    nodes, quadrature = lobatto(len(x[0]) + 1)
    weights = [
        [
            w
            * mpmath.fsum(
                (2 * j + 1) * mpmath.legendre(j, 2 * c - 1) * v for j, v in enumerate(row)
            )
            for c, w in zip(nodes, quadrature, strict=True)
        ]
        for row in x
    ]
    source = "research/find_magnus_methods.py"
    return MagnusMethod(_texts(nodes), map(_texts, weights), name=name, source=source)


def _texts(row: list[mpmath.mpf]) -> list[str]:
    return [mpmath.nstr(mpmath.nint(v * 10**36) / mpmath.mpf(10) ** 36, 37) for v in row]


def main() -> None:
    """Search, refine, print, and write a file if there is a folder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("order", type=int, choices=(4, 6, 8))
    parser.add_argument("flows", type=int)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--symmetric", action="store_true")
    parser.add_argument("--starts", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    free = search(given.order, given.flows, given.symmetric, given.starts, given.seed)
    if free is None:
        raise SystemExit("no start came to a solution")
    x = refine(free, given.order, given.flows, given.symmetric)
    method = method_of(x, f"CFM{given.order}")
    print(method, method.principal_error())
    if given.folder is not None:
        save(method, given.folder)


if __name__ == "__main__":
    main()
