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

Exponents may also combine brackets of earlier letters, :math:`h [\sum_k u_k L_k, \sum_k v_k L_k]`
with :math:`L_k = A(t_0 + c_k h)` or a bracket; weights on them follow those on nodes.
"""

from collections.abc import Callable, Sequence
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
Series = dict[Word, Any]
Degree = Callable[[Word], int]
Row = Sequence[Any]
Values = tuple[Row, Sequence[Row], Sequence[tuple[Row, Row]]]
"""The nodes, the weights of each exponential, and those of both sides of each bracket."""


@cache
def words(order: int) -> tuple[Word, ...]:
    """Return all words of degrees 1 to `order`, by degree: the compositions of these numbers."""
    by_degree: list[list[Word]] = [[()]]
    for degree in range(1, order + 1):
        by_degree.append(
            [(j, *rest) for j in range(1, degree + 1) for rest in by_degree[degree - j]]
        )
    return tuple(word for words in by_degree[1:] for word in words)


def as_decimal(value: Fraction) -> Decimal:
    """Return a fraction with the digits of the current context."""
    return Decimal(value.numerator) / value.denominator


def linear_residuals(values: Values, order: int) -> list[Decimal]:
    """Return the coefficients of all `words` less those of the solution, with 64 digits."""
    with localcontext(_DIGITS):
        product = product_of_exponentials(_each(as_decimal, values), order)
        return [product.get(word, 0) - _solution(word) for word in words(order)]


def estimated_order(values: Values) -> int:
    """Return the order that a method seems to have in double precision, an upper bound of it."""
    product = product_of_exponentials(_each(float, values), MAX_LINEAR_ORDER)
    wrong = [
        sum(word)
        for word in words(MAX_LINEAR_ORDER)
        if not abs(product.get(word, 0.0) - float(_solution(word))) <= _ROUGH
    ]
    return min(wrong, default=MAX_LINEAR_ORDER + 1) - 1


def linear_sensitivities(values: Values, units: Values, order: int) -> list[Decimal]:
    """Return bounds on the changes of the residuals when coefficients change by up to a unit.

    Coefficients of words are polynomials, without negative terms if brackets are replaced by sums:
    their increase is a bound.
    """
    with localcontext(_DIGITS):
        sizes = _each(abs, values)
        high = _each(as_decimal, _each(sum, sizes, units))
        low = product_of_exponentials(_each(as_decimal, sizes), order, sign=1)
        high = product_of_exponentials(high, order, sign=1)
        return [Decimal(high.get(word, 0) - low.get(word, 0)) for word in words(order)]


def _each(function: Callable[..., Any], *values: Any) -> Any:
    """Return nested sequences with the values of a function of one number of each."""
    if not isinstance(values[0], Sequence):
        return function(values if len(values) > 1 else values[0])
    return [_each(function, *parts) for parts in zip(*values, strict=True)]


def product_of_exponentials(values: Values, order: int, sign: int = -1) -> Series:
    """Return the coefficients of words through degree `order` in the result of a step.

    With a `sign` of 1 sums take the place of brackets, as they do in bounds.
    """
    nodes, rows, brackets = values
    degrees = range(1, order + 1)
    letters: list[Series] = [
        {(j,): c ** (j - 1) if j > 1 else c * 0 + 1 for j in degrees} for c in nodes
    ]
    for left, right in brackets:
        sides = combined(left, letters), combined(right, letters)
        letters.append(bracket(*sides, order, sign))
    product: Series = {(): nodes[0] * 0 + 1}
    for row in rows:
        product = times(exponential(combined(row, letters), order), product, order)
    return product


def combined(row: Sequence[Any], letters: Sequence[Series]) -> Series:
    """Return a combination of series."""
    total: Series = {}
    for weight, letter in zip(row, letters, strict=False):
        for word, x in letter.items() if weight else ():
            total[word] = total.get(word, 0) + weight * x
    return total


def bracket(a: Series, b: Series, order: int, sign: int = -1) -> Series:
    """Return the bracket of two series through a degree; with a `sign` of 1 both products add."""
    total = times(a, b, order)
    for word, x in times(b, a, order).items():
        total[word] = total.get(word, 0) + sign * x
    return total


def times(a: Series, b: Series, order: int, degree_of: Degree = sum) -> Series:
    """Return the words of a product through a degree."""
    second = sorted((degree_of(word), word) for word in b)
    product: Series = {}
    for first, x in a.items():
        room = order - degree_of(first)
        for degree, word in second:
            if degree > room:
                break
            product[first + word] = product.get(first + word, 0) + x * b[word]
    return product


def exponential(exponent: Series, order: int, degree_of: Degree = sum) -> Series:
    """Return the exponential of a series without a constant, through a degree."""
    power: Series = {(): 1}
    total = dict(power)
    for n in range(1, order + 1):
        power = {word: x / n for word, x in times(power, exponent, order, degree_of).items()}
        for word, x in power.items():
            total[word] = total.get(word, 0) + x
    return total


def _solution(word: Word) -> Decimal:
    value, degree = Decimal(1), 0
    for j in reversed(word):
        degree += j
        value /= degree
    return value
