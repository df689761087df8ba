"""What the searches for Magnus methods share: series in words, solvers, and Lobatto's nodes.

A(t) is expanded in K Legendre polynomials on the step; the coefficient of degree j - 1 is a letter
of degree j in the step size. What scipy's least_squares finds is refined to 60 digits.
"""

from collections.abc import Callable, Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cached_property, partial
from math import factorial
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray
from recipes import texts
from scipy.optimize import least_squares

from cg.construction.conditions.linear_equations import Series, Word, as_decimal
from cg.construction.solvers.polish import refine_rational
from cg.construction.solvers.singular import pseudo_inverse

Array = NDArray[Any]
Numbers = list[mpmath.mpf]

mpmath.mp.dps = 80
_GAP = 1e-9  # singular values below this fraction of the largest count as zero
_BELOW = Fraction(1, 10**65)


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

    def conditions(self, order: int, odd: bool) -> list[int]:
        """Return the places of the Lyndon words through a degree, or only those of odd degree.

        They are smaller than all their proper suffixes, and their conditions imply the others.
        """
        return [
            i
            for i, word in enumerate(self.words)
            if 0 < sum(word) <= order
            and (sum(word) % 2 or not odd)
            and all(word < word[k:] for k in range(1, len(word)))
        ]

    @cached_property
    def splits(self) -> tuple[Array, Array]:
        """Places of prefixes and suffixes of all words, shape (length + 1, words); -1 for none."""
        length = max(map(len, self.words))
        shape = (length + 1, len(self.words))
        first, second = np.full(shape, -1), np.full(shape, -1)
        for i, word in enumerate(self.words):
            for k in range(len(word) + 1):
                first[k, i], second[k, i] = self.index[word[:k]], self.index[word[k:]]
        return first, second

    @cached_property
    def places(self) -> tuple[Array, Array]:
        """Letters of all words from 0, padded to one length by K, and 1 / length!."""
        length = max(map(len, self.words))
        rows = [[j - 1 for j in w] + [self.letters] * (length - len(w)) for w in self.words]
        return np.array(rows).T, np.array([1 / factorial(len(w)) for w in self.words])

    def exponential(self, x: Array) -> Array:
        """Return the series of exp(Σ x_j A_j), shape (..., words)."""
        places, factors = self.places
        padded = np.concatenate([x, np.ones((*x.shape[:-1], 1))], axis=-1)
        product = padded[..., places[0]]
        for letters in places[1:]:
            product = product * padded[..., letters]
        return product * factors

    def multiply(self, a: Array, b: Array) -> Array:
        """Return the product of two series."""
        padded = [np.concatenate([s, np.zeros((*s.shape[:-1], 1))], axis=-1) for s in (a, b)]
        first, second = self.splits
        return sum(
            padded[0][..., u] * padded[1][..., v] for u, v in zip(first, second, strict=True)
        )

    def solution(self) -> Series:
        """Return the coefficients of words in the solution, letters being Legendre polynomials."""
        shifted = [_legendre(j) for j in range(self.letters)]
        values: Series = {}
        for word in self.words:
            inner = [Fraction(1)]
            for j in reversed(word):
                product = [Fraction(0)] * (len(inner) + j)
                for a, u in enumerate(inner):
                    for b, v in enumerate(shifted[j - 1]):
                        product[a + b] += u * v
                inner = [Fraction(0), *(c / (k + 1) for k, c in enumerate(product))]
            values[word] = sum(inner, Fraction(0))
        return values


def _legendre(degree: int) -> list[Fraction]:
    """Return the coefficients of the Legendre polynomial of 2θ - 1."""
    return [
        Fraction(
            (-1) ** (degree + k) * factorial(degree + k), factorial(k) ** 2 * factorial(degree - k)
        )
        for k in range(degree + 1)
    ]


def minimum(residuals: Callable[[Array], Array], x: Array, most: int, tolerance: float) -> Array:
    """Return where least_squares leads from x, with derivatives by complex steps."""

    def jacobian(x: Array) -> Array:
        step = 1e-30
        return (residuals(x + 1j * step * np.eye(x.size)).imag / step).T

    tolerances = dict.fromkeys(("xtol", "ftol", "gtol"), tolerance)
    return least_squares(residuals, x, jac=jacobian, max_nfev=most, **tolerances).x


def zero(residuals: Callable[[list[Decimal]], list[Decimal]], start: Array) -> Numbers:
    """Return a zero to 60 digits, by corrections of least norm from a start in double."""
    x = list(map(Fraction, start.tolist()))

    def exact(x: Sequence[Fraction]) -> list[Fraction]:
        return list(map(Fraction, residuals(list(map(as_decimal, x)))))

    with localcontext(prec=80):
        now, step = exact(x), Fraction(1, 10**30)
        moved = [exact([v + step * (i == j) for i, v in enumerate(x)]) for j in range(len(x))]
        jac = [[(b - a) / step for a, b in zip(now, row, strict=True)] for row in moved]
        inverse, _ = pseudo_inverse(np.array(jac, np.float64).T, _GAP)
        end = refine_rational(exact, x, inverse, below=_BELOW, grid=10**75)
    print(f"largest residual {float(end.largest_residual):.3g}")
    return list(map(number, end.x))


def number(x: Fraction) -> mpmath.mpf:
    """Return a fraction as a number of mpmath."""
    return mpmath.mpf(x.numerator) / x.denominator


def lobatto(count: int) -> tuple[Numbers, Numbers]:
    """Return Lobatto's nodes and weights on [0, 1]."""
    legendre = partial(mpmath.legendre, count - 1)
    inner = [
        mpmath.findroot(partial(mpmath.diff, legendre), mpmath.mpf(float(root)))
        for root in np.real(np.polynomial.Legendre.basis(count - 1).deriv().roots())
    ]
    nodes = [mpmath.mpf(-1), *sorted(inner), mpmath.mpf(1)]
    weights = [1 / (count * (count - 1) * legendre(x) ** 2) for x in nodes]
    return [(x + 1) / 2 for x in nodes], weights


def letters_at(nodes: Numbers, weights: Numbers, letters: int) -> list[Numbers]:
    """Return the letters, of a step, as combinations of values of A at the nodes of a formula."""
    return [
        [
            (2 * j + 1) * w * mpmath.legendre(j, 2 * c - 1)
            for c, w in zip(nodes, weights, strict=True)
        ]
        for j in range(letters)
    ]


def written(row: Numbers) -> list[str]:
    """Return numbers as `texts` of fractions."""
    return texts(Fraction(int(mpmath.nint(x * 10**60)), 10**60) for x in row)
