r"""Order conditions of products of exponentials, for linear equations and for splitting.

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

A step of a splitting method for H = T + V, with T quadratic in the momentum, is a composition of
flows of T (drifts) and V (kicks). A bracket of Hamiltonians that are polynomials of degrees m and n
in the momentum has degree m + n - 1, so that [V, [V, [V, T]]] = 0, and so are all brackets with
more kicks than drifts allow, on any manifold. What remains is the Lie algebra of :math:`\ddot q =
f(q)`, of which a splitting method is a Runge–Kutta–Nyström method with nodes c and weights
:math:`a_{ij} = b_j (c_i - c_j)`, j < i: c are sums of drifts, b kicks. Its conditions belong to the
special Nyström trees [1]_: rooted trees in which each node at an odd distance from the root has one
child at most. A method has order q if its drifts sum to 1 and :math:`\sum_i b_i \Phi_i(t) =
1/\gamma(t)` for all of them with up to q nodes; being symplectic, it satisfies the conditions for
positions as well. Independent are 2, 1, 2, 2, 4, 5, 10 and 14 conditions of orders 1 to 8, those of
even orders follow if the method is symmetric.

References
----------
.. [1] E. Hairer, S. P. Nørsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd
   ed., Springer, 1993, section II.14.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from functools import cache
from itertools import accumulate
from math import prod
from typing import Any

from cg.construction.trees import RootedTree, density, rooted_trees_through

MAX_LINEAR_ORDER = 9
"""Highest order whose conditions are offered; there are 511 words through this degree."""

LINEAR_ROUNDING = Decimal("1e-50")
"""Bound on the rounding errors of residuals of methods with weights of moderate size."""

_DIGITS = Context(prec=64)

Word = tuple[int, ...]
Series = dict[Word, Any]
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
        solution = {word: 1 / Decimal(prod(accumulate(reversed(word)))) for word in words(order)}
        return [product.get(word, 0) - value for word, value in solution.items()]


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
    return [_each(function, *items) for items in zip(*values, strict=True)]


def product_of_exponentials(values: Values, order: int, sign: int = -1) -> Series:
    """Return the coefficients of words through degree `order` in the result of a step.

    With a `sign` of 1 sums take the place of brackets, as they do in bounds.
    """
    nodes, rows, brackets = values
    degrees = range(1, order + 1)
    letters: list[Series] = [
        {(j,): c ** (j - 1) if j > 1 else c * 0 + 1 for j in degrees} for c in nodes
    ]
    for sides in brackets:
        left, right = (combination(side, letters) for side in sides)
        bracket = times(left, right, order)
        for word, x in times(right, left, order).items():
            bracket[word] = bracket.get(word, 0) + sign * x
        letters.append(bracket)
    product: Series = {(): nodes[0] * 0 + 1}
    for row in rows:
        product = times(exponential(combination(row, letters), order), product, order)
    return product


def combination(row: Sequence[Any], letters: Sequence[Series]) -> Series:
    """Return a combination of series."""
    total: Series = {}
    for weight, letter in zip(row, letters, strict=False):
        for word, x in letter.items() if weight else ():
            total[word] = total.get(word, 0) + weight * x
    return total


def times(a: Series, b: Series, order: int) -> Series:
    """Return the words of a product through a degree."""
    by_degree = sorted((sum(word), word) for word in b)
    product: Series = {}
    for left, x in a.items():
        room = order - sum(left)
        for degree, right in by_degree:
            if degree > room:
                break
            product[left + right] = product.get(left + right, 0) + x * b[right]
    return product


def exponential(exponent: Series, order: int) -> Series:
    """Return the exponential of a series without a constant, through a degree."""
    power: Series = {(): 1}
    total = dict(power)
    for n in range(1, order + 1):
        power = {word: x / n for word, x in times(power, exponent, order).items()}
        for word, x in power.items():
            total[word] = total.get(word, 0) + x
    return total


@cache
def nystrom_trees(order: int) -> tuple[RootedTree, ...]:
    """Return the special Nyström trees with 1 to `order` nodes, smaller ones first.

    Examples
    --------
    >>> [len(nystrom_trees(order)) for order in range(1, 9)]
    [1, 2, 4, 7, 13, 23, 43, 79]
    """
    return tuple(tree for tree in rooted_trees_through(order) if _is_special(tree))


def _is_special(tree: RootedTree) -> bool:
    return all(len(child) <= 1 and all(map(_is_special, child)) for child in tree)


def nystrom_residuals(drifts: Sequence[Any], kicks: Sequence[Any], order: int) -> list[Any]:
    """Return Σ drifts - 1, then the residuals Φ(t) - 1/γ(t) of `nystrom_trees`.

    Parameters
    ----------
    drifts, kicks
        Sequences of s + 1 and s numbers. Of any type that can be added, multiplied and divided by
        integers.
    order
        The largest number of nodes.
    """
    values = nystrom_values(drifts, kicks, order)
    one = values[0] * 0 + 1
    sides = (one / density(tree) for tree in nystrom_trees(order))
    return [value - side for value, side in zip(values, (one, *sides), strict=True)]


def nystrom_values(drifts: Sequence[Any], kicks: Sequence[Any], order: int) -> list[Any]:
    """Return Σ drifts, then Φ(t) of `nystrom_trees`: polynomials without negative coefficients."""
    nodes = list(accumulate(drifts))
    at_kicks: dict[RootedTree, list[Any]] = {}

    def flowed(tree: RootedTree) -> list[Any]:
        """Return Σ_j b_j (c_i - c_j) Φ_j(tree) at each kick i."""
        moved, speed, position = [], 0, 0
        for drift, kick, value in zip(drifts, kicks, phi(tree), strict=False):
            position = position + drift * speed
            moved.append(position)
            speed = speed + kick * value
        return moved

    def phi(tree: RootedTree) -> list[Any]:
        if tree not in at_kicks:
            rows = [flowed(child[0]) if child else nodes for child in tree]
            at_kicks[tree] = [prod(row[i] for row in rows) for i in range(len(kicks))]
        return at_kicks[tree]

    sums = (sum(map(prod, zip(kicks, phi(tree), strict=True))) for tree in nystrom_trees(order))
    return [nodes[-1], *sums]
