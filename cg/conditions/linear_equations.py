r"""Order conditions of products of exponentials for linear equations.

Let :math:`y' = A(t) y` with :math:`A(t_0 + \theta h) = \sum_j A_j \theta^{j-1}`. The solution and a
product of exponentials :math:`\exp(\Omega_s) \cdots \exp(\Omega_1)` with
:math:`\Omega_i = h \sum_k a_{ik} A(t_0 + c_k h) = h \sum_j x_{ij} A_j`,
:math:`x_{ij} = \sum_k a_{ik} c_k^{j-1}`, are series in the words :math:`A_{j_1} \cdots A_{j_n}`,
whose degree is :math:`j_1 + \dots + j_n`. In the solution a word has the coefficient

.. math:: \prod_{i=1}^{n} \frac{1}{j_i + j_{i+1} + \dots + j_n} ,

the integral of :math:`\theta_1^{j_1 - 1} \cdots \theta_n^{j_n - 1}` over
:math:`1 > \theta_1 > \dots > \theta_n > 0`. A product has order q if the coefficients of all words
through degree q agree.
"""

from collections.abc import Sequence
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from functools import cache
from typing import Any

MAX_LINEAR_ORDER = 9
"""Highest order whose conditions are offered; there are 511 words through this degree."""

LINEAR_ROUNDING = Decimal("1e-50")
"""Bound on the rounding errors of residuals of methods with weights of moderate size."""

_DIGITS = Context(prec=64)
_ROUGH = 1e-9  # far above rounding errors in double

Word = tuple[int, ...]
Rows = Sequence[Sequence[Fraction]]


@cache
def words(order: int) -> tuple[Word, ...]:
    """Return all words of degrees 1 to `order`, by degree: the compositions of these numbers."""
    by_degree: list[list[Word]] = [[()]]
    for degree in range(1, order + 1):
        by_degree.append(
            [(j, *rest) for j in range(1, degree + 1) for rest in by_degree[degree - j]]
        )
    return tuple(word for words in by_degree[1:] for word in words)


def linear_residuals(nodes: Sequence[Fraction], rows: Rows, order: int) -> list[Decimal]:
    """Return the coefficients of all `words` less those of the solution, with 64 digits.

    `nodes` are c, shape (K,); `rows` the weights a in the order of application, shape (s, K).
    """
    with localcontext(_DIGITS):
        product = product_of_exponentials(_moments(nodes, rows, order), words(order))
        return [product[word] - _solution(word) for word in words(order)]


def estimated_order(nodes: Sequence[Fraction], rows: Rows) -> int:
    """Return the order that a method seems to have in double precision, an upper bound of it."""
    moments = [[float(x) for x in row] for row in _moments(nodes, rows, MAX_LINEAR_ORDER)]
    product = product_of_exponentials(moments, words(MAX_LINEAR_ORDER))
    wrong = [
        sum(word)
        for word in words(MAX_LINEAR_ORDER)
        if not abs(product[word] - float(_solution(word))) <= _ROUGH
    ]
    return min(wrong, default=MAX_LINEAR_ORDER + 1) - 1


def linear_sensitivities(
    nodes: Sequence[Fraction], rows: Rows, node_units: Sequence[Fraction], units: Rows, order: int
) -> list[Decimal]:
    """Return bounds on the changes of the residuals when coefficients change by up to a unit.

    Coefficients of words are polynomials without negative terms: their increase is a bound.
    """
    sizes = [abs(c) for c in nodes]
    wide = [c + unit for c, unit in zip(sizes, node_units, strict=True)]
    weights = [[abs(a) for a in row] for row in rows]
    wide_weights = [
        [a + unit for a, unit in zip(row, unit_row, strict=True)]
        for row, unit_row in zip(weights, units, strict=True)
    ]
    with localcontext(_DIGITS):
        low = product_of_exponentials(_moments(sizes, weights, order), words(order))
        high = product_of_exponentials(_moments(wide, wide_weights, order), words(order))
        return [high[word] - low[word] for word in words(order)]


def _moments(nodes: Sequence[Fraction], rows: Rows, order: int) -> list[list[Decimal]]:
    """Return x, shape (s, order)."""
    powers = [[_decimal(c) ** j if j else Decimal(1) for j in range(order)] for c in nodes]
    weights = [[_decimal(a) for a in row] for row in rows]
    return [
        [
            sum((a * power[j] for a, power in zip(row, powers, strict=True)), Decimal(0))
            for j in range(order)
        ]
        for row in weights
    ]


def product_of_exponentials(x: Sequence[Sequence[Any]], words: Sequence[Word]) -> dict[Word, Any]:
    """Return the coefficients of words in a product of exponentials of combinations of letters.

    `x` are the weights of the letters in each exponential, in the order of application. `words`
    hold all their prefixes and suffixes, shorter ones first.
    """
    one = x[0][0] * 0 + 1
    product: dict[Word, Any] = {(): one} | dict.fromkeys(words, one * 0)
    for row in x:
        factor: dict[Word, Any] = {(): one}
        for word in words:
            factor[word] = factor[word[1:]] * row[word[0] - 1] / len(word)
        product = {
            word: sum((factor[word[:k]] * product[word[k:]] for k in range(len(word) + 1)), one * 0)
            for word in product
        }
    return product


def _solution(word: Word) -> Decimal:
    value, degree = Decimal(1), 0
    for j in reversed(word):
        degree += j
        value /= degree
    return value


def _decimal(value: Fraction) -> Decimal:
    return Decimal(value.numerator) / value.denominator
