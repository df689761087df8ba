"""Order conditions of Runge–Kutta methods on manifolds.

A method has order q if ``Φ(t) = 1/γ(t)`` for all ordered trees with 2 to q + 1 nodes, (2.4) of
Jackiewicz, Marthinsen and Owren. A method is a tree of points (`cg.points`): the flow to point m
starts from its parent and has weights α_mk on the fields of stages k, and Φ is the weight at the
result. At each point weights are a character χ of words of trees, with the leftmost child on the
flow that comes first::

    χ_m(w) = Σ_{w = u v} χ_parent(m)(u) ℓ_m(v_1) … ℓ_m(v_n) / n!,    n the length of v
    ℓ_m(t) = Σ_k α_mk Φ_k(t),    Φ_k(t) = χ(children of t) at the point of stage k

In a Crouch–Grossman tableau each row is a chain of points with one weight each, so that::

    Φ_r([t_1 … t_μ]) = Σ_{i_1 ≤ … ≤ i_μ} Π_j a_{r,i_j} Φ_{i_j}(t_j) / Π (runs of equal i)!

and ``Φ`` itself has ``b`` in place of ``a_r``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from math import factorial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core_r64, compiled_conditions
from .checks import check_integer
from .layout import Layout, Rows, check_rows, rows_of, unknowns
from .points import START, PointTree, tree_of_rows
from .precision import working_precision
from .texts import read_fraction
from .trees import MOST_NODES, forest

if TYPE_CHECKING:
    from flint import arb, fmpq

__all__ = [
    "HIGHEST_ORDER",
    "Rows",
    "ball_residuals_of",
    "check_rows",
    "condition_trees",
    "count",
    "count_classical",
    "exact_residuals_of",
    "exact_weights",
    "jacobian",
    "jacobian_at",
    "pack",
    "residuals",
    "residuals_at",
    "residuals_exact",
    "residuals_of",
    "right_sides",
    "table_rows",
    "unknowns",
    "unpack",
    "weights",
    "weights_at",
]

HIGHEST_ORDER: int = int(_core_r64.highest_order())
"""Highest order that the compiled tables of trees hold (a build option)."""

_MOST_TREES_ORDER = MOST_NODES - 1
_MOST_CLASSICAL = 2000

ExactRows = Sequence[Sequence[Any]]


class HasTree(Protocol):
    """A tree of points, or a method, which has one."""

    @property
    def tree(self) -> PointTree:
        """The points."""


def _check_order(order: int, highest: int | None = HIGHEST_ORDER) -> int:
    checked = check_integer("order", order, 1, None if highest else _MOST_TREES_ORDER)
    if highest is not None and checked > highest:
        raise ValueError(
            f"order must be at most {highest}, the highest that the tables were built for "
            f"(build option highest_order), got {order}"
        )
    return checked


@lru_cache(maxsize=None, typed=True)  # typed, or True would be found as 1
def condition_trees(order: int, independent: bool = False) -> tuple[int, ...]:
    """Return the indices of the trees whose conditions give this order.

    Parameters
    ----------
    order : int
        At least 1.
    independent : bool, optional
        Leave out the trees whose condition follows from those of lower order: keep
        the words of trees that are Lyndon words.
    """
    order = _check_order(order, None)
    trees = forest(order + 1)
    indices = range(2, len(trees) + 1)
    if not independent:
        return tuple(indices)
    return tuple(index for index in indices if trees.is_independent(index))


@lru_cache(maxsize=None, typed=True)
def table_rows(order: int) -> tuple[int, ...]:
    """Return the paper's integer table: tree indices, zero where a tree can be discarded."""
    independent = set(condition_trees(order, independent=True))
    return tuple(t if t in independent else 0 for t in condition_trees(order))


def count(order: int, independent: bool = False) -> int:
    """Return the number of order conditions through `order` (``N_CG`` if independent)."""
    return len(condition_trees(_check_order(order, None), independent))


def count_classical(order: int) -> int:
    """Return ``N_RK``: rooted trees, children unordered, with 1 to `order` nodes.

    A rooted tree is a multiset of rooted trees under a root; this counts such
    multisets by the usual recurrence over divisors.

    Parameters
    ----------
    order : int
        At most 2000.
    """
    order = check_integer("order", order, 1, _MOST_CLASSICAL)
    trees = [0, 1]
    of_size = [0] * (order + 1)  # Σ d t_d over the divisors d of each k
    for n in range(1, order):
        for k in range(n, order + 1, n):
            of_size[k] += n * trees[n]
        trees.append(sum(of_size[k] * trees[n - k + 1] for k in range(1, n + 1)) // n)
    return sum(trees)


def right_sides(order: int, independent: bool = False) -> tuple[Fraction, ...]:
    """Return ``1/γ(t)`` for the trees of `condition_trees`."""
    trees = forest(_check_order(order, None) + 1)
    return tuple(Fraction(1, trees.density[t - 1]) for t in condition_trees(order, independent))


def _check_tableau(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    checked = []
    for name, value in (("a", a), ("b", b)):
        try:
            if np.ma.is_masked(value):
                raise TypeError("masked")
            given = np.asarray(value)
            if given.dtype.kind not in "iufO":  # complex numbers would lose a part
                raise TypeError("not real")
            array = given.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{name} must be an array of real numbers, got {value!r}") from None
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite, got {array}")
        checked.append(array)
    weights_, stages = checked[1], checked[1].size
    if weights_.ndim != 1 or stages == 0:
        raise ValueError(f"b must have shape (s,) with s at least 1, got {weights_.shape}")
    if checked[0].shape != (stages, stages):
        raise ValueError(
            f"a must have shape ({stages}, {stages}) to match b, got {checked[0].shape}"
        )
    return checked[0], weights_


def pack(a: ArrayLike, b: ArrayLike, rows: Rows | None = None) -> NDArray[np.float64]:
    """Pack a tableau's entries row by row, ``b`` last.

    Parameters
    ----------
    a : array_like, shape (s, s)
    b : array_like, shape (s,)
    rows : Rows, optional
        Which entries to take; by default the narrowest pattern that loses none.

    Returns
    -------
    ndarray, shape (unknowns(s, rows),)

    Raises
    ------
    ValueError
        If shapes don't match, an entry isn't finite, or `rows` would lose a nonzero entry.
    """
    a_array, b_array = _check_tableau(a, b)
    narrowest = rows_of(a_array)
    rows = narrowest if rows is None else check_rows(rows)
    if rows < narrowest:
        raise ValueError(f"a has nonzero entries outside the pattern {rows.name.lower()}")
    return np.array(
        Layout.tableau(b_array.size, rows).packed([*a_array.tolist(), b_array.tolist()])
    )


def unpack(
    x: Sequence[Any] | NDArray[Any], stages: int, rows: Rows = Rows.EXPLICIT
) -> tuple[list[list[Any]], list[Any]]:
    """Unpack what `pack` packed, into full rows of ``a`` and ``b``; zeros are ints."""
    *a, b = Layout.tableau(stages, rows).full_rows(x)
    return a, b


def weights(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t)`` for the trees of `condition_trees`; arguments as for `residuals`."""
    order = _check_order(order)
    return weights_at(*_packed(*_check_tableau(a, b)), order, independent)


def residuals(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t) - 1/γ(t)`` for all conditions through an order, in double precision.

    Parameters
    ----------
    a : array_like, shape (s, s)
        Any real matrix; implicit tableaux are those with entries on or above the diagonal.
    b : array_like, shape (s,)
    order : int
        Between 1 and `HIGHEST_ORDER`.
    independent : bool, optional
        Only the conditions that don't follow from others of lower order.

    Returns
    -------
    ndarray, shape (count(order, independent),)

    Raises
    ------
    ValueError
        If a shape doesn't match, an entry isn't finite, or the order is out of range.
    """
    order = _check_order(order)
    return residuals_at(*_packed(*_check_tableau(a, b)), order, independent)


def jacobian(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False, rows: Rows | None = None
) -> NDArray[np.float64]:
    """Return the derivatives of `residuals` by the packed entries of the tableau.

    Parameters
    ----------
    a, b, order, independent
        As for `residuals`.
    rows : Rows, optional
        The entries to derive by; by default the narrowest pattern that holds ``a``.

    Returns
    -------
    ndarray, shape (count(order, independent), unknowns(s, rows))
    """
    order = _check_order(order)
    return jacobian_at(*_packed(*_check_tableau(a, b), rows), order, independent)


def _packed(
    a: NDArray[np.float64], b: NDArray[np.float64], rows: Rows | None = None
) -> tuple[Layout, NDArray[np.float64]]:
    rows = rows_of(a) if rows is None else check_rows(rows)
    return Layout.tableau(b.size, rows), pack(a, b, rows)


def weights_at(
    layout: Layout, x: NDArray[np.float64], order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t)`` for the trees of `condition_trees`; arguments as for `residuals_at`."""
    return compiled_conditions.weights(order, layout, x, _trees(order, independent))


def residuals_at(
    layout: Layout, x: NDArray[np.float64], order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t) - 1/γ(t)`` of the result of a step, in double precision.

    Parameters
    ----------
    layout : Layout
    x : ndarray, shape (layout.size,)
        Packed weights.
    order : int
        Between 1 and `HIGHEST_ORDER`.
    independent : bool, optional
        As for `residuals`.

    Returns
    -------
    ndarray, shape (count(order, independent),)
    """
    return compiled_conditions.residuals(order, layout, x, _trees(order, independent))


def jacobian_at(
    layout: Layout, x: NDArray[np.float64], order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return the derivatives of `residuals_at` by the packed weights.

    Returns
    -------
    ndarray, shape (count(order, independent), layout.size)
    """
    trees = _trees(order, independent)
    return np.ascontiguousarray(compiled_conditions.jacobian(order, layout, x, trees))


def _trees(order: int, independent: bool) -> NDArray[np.intc]:
    return np.array(condition_trees(order, independent), dtype=np.intc)


def residuals_of(
    method: HasTree, order: int, independent: bool = False, *, embedded: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t) - 1/γ(t)`` of a method, in double precision.

    Parameters
    ----------
    method : Method or PointTree
    order, independent
        As for `residuals`.
    embedded : bool, optional
        Of the second result of a pair.

    Returns
    -------
    ndarray, shape (count(order, independent),)

    Raises
    ------
    ValueError
        If the order is out of range, or there is no second result.
    """
    order = _check_order(order)
    tree = _tree_of(method, embedded)
    layout = Layout.of_tree(tree)
    x = [float(weight) for point in tree.points for weight in point.weights.values()]
    return residuals_at(layout, np.array(x, dtype=np.float64), order, independent)


def _tree_of(method: HasTree, embedded: bool) -> PointTree:
    tree = method.tree
    if not embedded:
        return replace(tree, embedded_result=None)
    if tree.embedded_result is None:
        raise ValueError(f"embedded: {method!r} has no second result")
    return replace(tree, result=tree.embedded_result, embedded_result=None)


def residuals_exact(
    a: ExactRows, b: Sequence[Any], order: int, independent: bool = False
) -> tuple[Fraction, ...]:
    """Return ``Φ(t) - 1/γ(t)`` of a tableau in exact rational arithmetic.

    Parameters
    ----------
    a : sequence of s sequences of s numbers
        Anything that `fractions.Fraction` takes: integers, floats, ``"119/216"``, ``"0.25"``.
    b : sequence of s numbers
    order : int
        Between 1 and 13; not limited by the compiled tables.
    independent : bool, optional
        As for `residuals`.

    Returns
    -------
    tuple of Fraction

    Raises
    ------
    ValueError
        If a shape doesn't match, an entry isn't a finite real number, or the order is out of
        range.
    """
    order = _check_order(order, None)
    weights_row = _rationals(b, "b")
    if not isinstance(a, Iterable) or isinstance(a, str | bytes):
        raise ValueError(f"a must be a sequence of rows, got {a!r}")
    rows = [_rationals(row, f"row {i} of a") for i, row in enumerate(a, 1)]
    stages = len(weights_row)
    if stages == 0 or len(rows) != stages or any(len(row) != stages for row in rows):
        shape = (len(rows), sorted({len(row) for row in rows}))
        raise ValueError(f"a must have shape ({stages}, {stages}) to match b, got {shape}")
    return exact_residuals_of(tree_of_rows(rows, weights_row), order, independent)


def exact_residuals_of(
    method: HasTree, order: int, independent: bool = False, *, embedded: bool = False
) -> tuple[Fraction, ...]:
    """Return ``Φ(t) - 1/γ(t)`` of a method in exact rational arithmetic.

    Parameters
    ----------
    method, embedded
        As for `residuals_of`.
    order, independent
        As for `residuals_exact`.

    Returns
    -------
    tuple of Fraction
    """
    order = _check_order(order, None)
    tree = _tree_of(method, embedded)
    found = exact_weights(tree, order, condition_trees(order, independent), _flint)
    return tuple(
        Fraction(int(phi.p), int(phi.q)) - side
        for phi, side in zip(found, right_sides(order, independent), strict=True)
    )


def ball_residuals_of(
    method: HasTree, order: int, independent: bool = False, *, bits: int = 512
) -> tuple[arb, ...]:
    """Return balls that the ``Φ(t) - 1/γ(t)`` of a method are in, at high orders far sooner.

    Parameters
    ----------
    method : Method or PointTree
    order, independent
        As for `residuals_exact`.
    bits : int, optional
        Precision of the midpoints.

    Returns
    -------
    tuple of arb
    """
    order = _check_order(order, None)
    tree = _tree_of(method, False)
    with working_precision(bits):
        found = exact_weights(tree, order, condition_trees(order, independent), _ball)
        sides = right_sides(order, independent)
        return tuple(phi - _ball(side) for phi, side in zip(found, sides, strict=True))


def exact_weights(
    tree: PointTree, order: int, wanted: Sequence[int], number: Callable[[Fraction], Any]
) -> list[Any]:
    r"""Return ``Φ(t)`` of the result of a step, in any field of numbers.

    This follows the definition word by word, for one point after the other, and shares no code
    with the compiled core, whose oracle it is: with the letters
    :math:`\ell_m(t) = \sum_k lpha_{m,k} \Phi_k(t)`,

    .. math:: \chi_m(w) = \sum_{w = u v} \chi_{\mathrm{parent}(m)}(u)\,
              \ell_m(v_1) \cdots \ell_m(v_n) / n!.

    Parameters
    ----------
    tree : PointTree
    order : int
        At most so many nodes do the trees of stages have.
    wanted : sequence of int
        Indices of trees with at most one node more.
    number : callable
        Makes a number of a Fraction.

    Returns
    -------
    list of numbers
    """
    trees = forest(order + 1)
    weights_of = [
        {k: number(weight) for k, weight in point.weights.items()} for point in tree.points
    ]
    used = {m for at in tree.stage_points for m in tree.path(at)}
    inner, last = sorted(used), tree.path(tree.result)
    letters: dict[int, list[Any]] = {}

    def add_letter(t: int, phi: Sequence[Any]) -> None:
        letters[t] = [
            sum((weight * phi[k] for k, weight in row.items() if phi[k] != 0), start=zero)
            for row in weights_of
        ]

    one = number(Fraction(1))
    zero = one * 0
    add_letter(1, [one] * len(tree.stage_points))
    for t in range(2, trees.with_nodes(order).stop):
        ends = _word_weights(tree, inner, trees.children[t - 1], letters, one)
        add_letter(t, [ends[at] for at in tree.stage_points])
    return [
        _word_weights(tree, last, trees.children[t - 1], letters, one)[tree.result] for t in wanted
    ]


def _word_weights(
    tree: PointTree,
    points: Sequence[int],
    word: Sequence[int],
    letters: Mapping[int, Sequence[Any]],
    one: Any,
) -> dict[int, Any]:
    """Return the character of each point on a word: sums over where its letters are taken."""
    zero = one * 0
    taken = {START: [one] + [zero] * len(word)}  # by the number of letters taken so far
    for m in points:
        before = taken[tree.points[m].parent]
        after = before.copy()
        for end in range(1, len(word) + 1):
            product = one
            for begin in range(end - 1, -1, -1):
                product = product * letters[word[begin]][m]
                if product == 0:
                    break
                after[end] = after[end] + before[begin] * product / factorial(end - begin)
        taken[m] = after
    return {m: row[-1] for m, row in taken.items()}


def _rationals(entries: Any, name: str) -> list[Fraction]:
    if not isinstance(entries, Iterable) or isinstance(entries, str | bytes):
        raise ValueError(f"{name} must be a sequence of numbers, got {entries!r}")
    return [_rational(entry, name) for entry in entries]


def _rational(entry: Any, name: str) -> Fraction:
    try:
        return read_fraction(entry.item() if isinstance(entry, np.generic) else entry)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise ValueError(f"{name} must hold finite real numbers, got {entry!r}") from None


def _flint(value: Fraction) -> fmpq:
    # many times faster than Fractions where digits are many
    from flint import fmpq

    return fmpq(value.numerator, value.denominator)


def _ball(value: Fraction) -> arb:
    from flint import arb

    return arb(_flint(value))
