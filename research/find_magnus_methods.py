"""Search for the commutator-free Magnus methods of orders six and eight, and write their files.

    python research/find_magnus_methods.py ORDER FLOWS [FOLDER] [--symmetric] [--optimise]

``6 4`` finds four flows for order six, ``8 8 --symmetric`` eight flows for order eight, ``6 6
--symmetric --optimise --seed 1 --starts 2`` six flows for order six with a small error. A(t) is
expanded in K = ORDER/2 Legendre polynomials on the step, with --optimise in one more; Lobatto's
formula with K + 1 nodes integrates all that the order needs. With x_ij the weight of polynomial j
in exponential i, the order conditions are those of Lyndon words in K letters of degrees 1 to K (of
odd degree, if the method is symmetric). scipy's least_squares solves them from random starts, with
--optimise near the integrals over equal parts of the step; it then moves along the set of solutions
towards smaller coefficients of words of degree ORDER + 1. Newton's method in multiple precision
(mpmath) refines the solution with the smallest Σ|x_i1|, with --optimise that with the smallest norm
of these coefficients.
"""

import argparse
from collections.abc import Callable
from fractions import Fraction
from functools import cached_property
from math import factorial
from pathlib import Path

import mpmath
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cg.catalogue import save
from cg.method.magnus import MagnusMethod

Array = NDArray[np.float64]
Word = tuple[int, ...]


class Words:
    """Words in K letters of degrees 1 to K, and the algebra of series in them."""

    def __init__(self, letters: int, degree: int) -> None:
        self.letters, self.degree = letters, degree
        self.words = sorted(self._through(degree), key=lambda word: (sum(word), word))
        self.index = {word: i for i, word in enumerate(self.words)}

    def _through(self, degree: int) -> list[Word]:
        rest = [
            (j, *word)
            for j in range(1, min(self.letters, degree) + 1)
            for word in self._through(degree - j)
        ]
        return [(), *rest]

    @cached_property
    def lyndon(self) -> list[int]:
        """Places of the words that are smaller than all their proper suffixes."""
        return [
            i
            for i, word in enumerate(self.words)
            if word and all(word < word[k:] for k in range(1, len(word)))
        ]

    @cached_property
    def splits(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Places of prefixes and suffixes of all words, shape (length + 1, words); -1 for none."""
        length = max(map(len, self.words))
        shape = (length + 1, len(self.words))
        first, second = np.full(shape, -1), np.full(shape, -1)
        for i, word in enumerate(self.words):
            for k in range(len(word) + 1):
                first[k, i], second[k, i] = self.index[word[:k]], self.index[word[k:]]
        return first, second

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], Array]:
        """Letters of all words from 0, padded to one length by K, and 1 / length!."""
        length = max(map(len, self.words))
        rows = [[j - 1 for j in w] + [self.letters] * (length - len(w)) for w in self.words]
        return np.array(rows).T, np.array([1 / factorial(len(w)) for w in self.words])

    def exponential(self, x: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the series of exp(Σ x_j A_j), shape (..., words)."""
        places, factors = self.places
        padded = np.concatenate([x, np.ones((*x.shape[:-1], 1))], axis=-1)
        product = padded[..., places[0]]
        for letters in places[1:]:
            product = product * padded[..., letters]
        return product * factors

    def multiply(
        self, a: NDArray[np.complex128], b: NDArray[np.complex128]
    ) -> NDArray[np.complex128]:
        """Return the product of two series."""
        padded = [np.concatenate([s, np.zeros((*s.shape[:-1], 1))], axis=-1) for s in (a, b)]
        first, second = self.splits
        return sum(
            padded[0][..., u] * padded[1][..., v] for u, v in zip(first, second, strict=True)
        )

    def solution(self) -> list[Fraction]:
        """Return the coefficients of words in the solution, letters being Legendre polynomials."""
        shifted = [_legendre(j) for j in range(self.letters)]
        values = []
        for word in self.words:
            inner = [Fraction(1)]
            for j in reversed(word):
                product = [Fraction(0)] * (len(inner) + j)
                for a, u in enumerate(inner):
                    for b, v in enumerate(shifted[j - 1]):
                        product[a + b] += u * v
                inner = [Fraction(0), *(c / (k + 1) for k, c in enumerate(product))]
            values.append(sum(inner, Fraction(0)))
        return values


def _legendre(degree: int) -> list[Fraction]:
    """Return the coefficients of the Legendre polynomial of 2θ - 1."""
    return [
        Fraction(
            (-1) ** (degree + k) * factorial(degree + k), factorial(k) ** 2 * factorial(degree - k)
        )
        for k in range(degree + 1)
    ]


def expand(movable: Array, flows: int, letters: int, symmetric: bool) -> Array:
    """Return x, shape (..., flows, letters), from its free entries."""
    if not symmetric:
        return movable.reshape(*movable.shape[:-1], flows, letters)
    half = movable.reshape(*movable.shape[:-1], flows // 2, letters)
    signs = (-1) ** np.arange(letters)
    return np.concatenate([half, half[..., ::-1, :] * signs], axis=-2)


def search(
    order: int, flows: int, symmetric: bool, starts: int, seed: int, optimise: bool
) -> Array | None:
    """Return the free entries of the best solution; None without any."""
    letters = order // 2 + optimise
    algebra = Words(letters, order + optimise)
    exact = np.array(algebra.solution(), dtype=np.float64)
    rows = conditions(algebra, order, symmetric)
    beyond = [i for i, word in enumerate(algebra.words) if sum(word) > order]
    size = flows * letters // (2 if symmetric else 1)

    def series(movable: Array) -> Array:
        x = expand(movable, flows, letters, symmetric)
        product = algebra.exponential(x[..., 0, :])
        for i in range(1, flows):
            product = algebra.multiply(algebra.exponential(x[..., i, :]), product)
        return product - exact

    def solve(movable: Array, weight: float, most: int = 200) -> Array:
        def residuals(movable: Array) -> Array:
            found = series(movable)
            return np.concatenate([found[..., rows], weight * found[..., beyond]], axis=-1)

        def jacobian(movable: Array) -> Array:
            step = 1e-30
            return (residuals(movable + 1j * step * np.eye(size)).imag / step).T

        return least_squares(
            residuals, movable, jac=jacobian, max_nfev=most, xtol=1e-15, ftol=1e-15, gtol=1e-15
        ).x

    random, best = np.random.default_rng(seed), None
    for k in range(starts):
        if optimise:
            scale = random.choice([0.05, 0.1, 0.2, 0.4])
            movable = integrals(flows, letters)[:size] + scale * random.normal(size=size)
        else:
            movable = random.uniform(-0.6, 0.8, size)
        for weight in (0.0, *((1e-1, 1e-2, 1e-3, 1e-4, 0.0) if optimise else ())):
            movable = solve(movable, weight)
        found = series(movable)
        if np.abs(found[rows]).max() < 1e-11:
            length = np.abs(expand(movable, flows, letters, symmetric)[:, 0]).sum()
            error = float(np.linalg.norm(found[beyond])) if optimise else length
            print(f"start {k}: sum of |x_i1| {length:.4f}, error {error:.4g}", flush=True)
            if best is None or error < best[0] * (1 - 1e-9):
                best = error, movable
    return None if best is None else best[1]


def conditions(algebra: Words, order: int, symmetric: bool) -> list[int]:
    """Return the places of the words whose conditions imply an order."""
    degrees = {i: sum(algebra.words[i]) for i in algebra.lyndon}
    return [i for i, n in degrees.items() if n <= order and (n % 2 or not symmetric)]


def integrals(flows: int, letters: int) -> Array:
    """Return the integrals of Legendre polynomials over equal parts of the step, one by one."""
    ends = np.linspace(-1, 1, flows + 1)
    values = [np.polynomial.Legendre.basis(j).integ()(ends) / 2 for j in range(letters)]
    return np.diff(np.array(values), axis=1).T.reshape(-1)


def refine(
    movable: Array, order: int, flows: int, symmetric: bool, letters: int
) -> list[list[mpmath.mpf]]:
    """Return x to 60 digits by the Gauss–Newton method, with differences for the Jacobian."""
    mpmath.mp.dps = 80
    algebra = Words(letters, order)
    exact = [mpmath.mpf(c.numerator) / c.denominator for c in algebra.solution()]
    rows = conditions(algebra, order, symmetric)

    def x_of(movable: list[mpmath.mpf]) -> list[list[mpmath.mpf]]:
        x = [movable[letters * i : letters * (i + 1)] for i in range(len(movable) // letters)]
        mirrored = [[(-1) ** j * v for j, v in enumerate(row)] for row in reversed(x)]
        return x + mirrored if symmetric else x

    def residuals(movable: list[mpmath.mpf]) -> list[mpmath.mpf]:
        product = {word: mpmath.mpf(not word) for word in algebra.words}
        for row in x_of(movable):
            factor = {
                word: mpmath.fprod(row[j - 1] for j in word) / factorial(len(word))
                for word in algebra.words
            }
            product = {
                word: mpmath.fsum(
                    factor[word[:k]] * product[word[k:]] for k in range(len(word) + 1)
                )
                for word in product
            }
        return [product[algebra.words[i]] - exact[i] for i in rows]

    point = [mpmath.mpf(float(v)) for v in movable]
    for _ in range(5):
        now, step = residuals(point), mpmath.mpf(10) ** -40
        columns = []
        for j in range(len(point)):
            moved = [v + step * (i == j) for i, v in enumerate(point)]
            columns.append([(b - a) / step for a, b in zip(now, residuals(moved), strict=True)])
        jacobian = mpmath.matrix(columns).T  # the change of least norm
        normal = mpmath.lu_solve(jacobian * jacobian.T, mpmath.matrix([-v for v in now]))
        change = jacobian.T * normal
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
        for root in np.real(np.polynomial.Legendre.basis(count - 1).deriv().roots())
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
    parser.add_argument("--optimise", action="store_true")
    parser.add_argument("--starts", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    movable = search(
        given.order, given.flows, given.symmetric, given.starts, given.seed, given.optimise
    )
    if movable is None:
        raise SystemExit("no start came to a solution")
    letters = given.order // 2 + given.optimise
    x = refine(movable, given.order, given.flows, given.symmetric, letters)
    method = method_of(x, f"CFM{given.order}")
    print(method, method.principal_error)
    if given.folder is not None:
        save(method, given.folder)


if __name__ == "__main__":
    main()
