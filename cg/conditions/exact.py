"""Order conditions in exact arithmetic, directly from their definition.

This module shares no code with the compiled core, and the tests compare both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from math import factorial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..structure.points import START, PointTree, check_not_sums, points_of, tree_of_rows
from ..support.balls import to_ball, to_flint, to_fraction, working_precision
from ..support.checks import check_flag, check_integer
from ..support.parsing import read_fraction
from ..trees.ordered import forest
from .counts import check_order, condition_trees, right_sides

if TYPE_CHECKING:
    from flint import arb

ExactRows = Sequence[Sequence[Any]]

_MAX_BITS = 1_000_000  # with more bits a sum of products would take hours


class HasTree(Protocol):
    """An object with a tree of points: a method, or a tree itself."""

    @property
    def tree(self) -> PointTree:
        """The points."""


def residuals_exact(
    a: ExactRows, b: Sequence[Any], order: int, independent: bool = False
) -> tuple[Fraction, ...]:
    """Return ``Φ(t) - 1/γ(t)`` of a tableau in exact rational arithmetic.

    Parameters
    ----------
    a : sequence of s sequences of s numbers
        Arguments of `fractions.Fraction`: integers, floats, ``"119/216"``, ``"0.25"``.
    b : sequence of s numbers
    order : int
        Between 1 and 13; the compiled tables are not used.
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

    Examples
    --------
    Heun's method of order three has order two on manifolds.

    >>> a, b = [[0, 0, 0], ["1/3", 0, 0], [0, "2/3", 0]], ["1/4", 0, "3/4"]
    >>> any(residuals_exact(a, b, 2))
    False
    >>> [str(residual) for residual in residuals_exact(a, b, 3)[3:]]
    ['0', '-1/48', '1/48', '0', '0']
    """
    order = check_order(order, None)
    weights_row = _rationals(b, "b")
    check_not_sums(a)
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

    Examples
    --------
    >>> import cg
    >>> any(exact_residuals_of(cg.methods["CG3"], 3))
    False
    >>> any(exact_residuals_of(cg.methods["CG3"], 4))
    True
    """
    order = check_order(order, None)
    tree = result_tree(method, embedded)
    weights = exact_weights(tree, order, condition_trees(order, independent), to_flint)
    return tuple(
        to_fraction(phi) - side
        for phi, side in zip(weights, right_sides(order, independent), strict=True)
    )


def ball_residuals_of(
    method: HasTree, order: int, independent: bool = False, *, bits: int = 512
) -> tuple[arb, ...]:
    """Return balls that contain the ``Φ(t) - 1/γ(t)`` of a method; faster than exact arithmetic.

    Parameters
    ----------
    method : Method or PointTree
    order, independent
        As for `residuals_exact`.
    bits : int, optional
        Precision of the midpoints, at most a million.

    Returns
    -------
    tuple of arb

    Examples
    --------
    >>> import cg
    >>> balls = ball_residuals_of(cg.methods["CF4"], 4)
    >>> all(0 in ball for ball in balls)
    True
    """
    order = check_order(order, None)
    tree = result_tree(method, False)
    bits = check_integer("bits", bits, 2, _MAX_BITS)
    with working_precision(bits):
        weights = exact_weights(tree, order, condition_trees(order, independent), to_ball)
        sides = right_sides(order, independent)
        return tuple(phi - to_ball(side) for phi, side in zip(weights, sides, strict=True))


def exact_weights(
    tree: PointTree, order: int, indices: Sequence[int], number: Callable[[Fraction], Any]
) -> list[Any]:
    r"""Return ``Φ(t)`` of the result of a step, in any field of numbers.

    This evaluates the definition for each tree and point. With the letters
    :math:`\ell_m(t) = \sum_k \alpha_{m,k} \Phi_k(t)`,

    .. math:: \chi_m(w) = \sum_{w = u v} \chi_{\mathrm{parent}(m)}(u)\,
              \ell_m(v_1) \cdots \ell_m(v_n) / n!.

    Parameters
    ----------
    tree : PointTree
    order : int
        Largest number of nodes of the trees that are evaluated at stages.
    indices : sequence of int
        Indices of the trees, which have at most ``order + 1`` nodes.
    number : callable
        Converts a Fraction to a number.

    Returns
    -------
    list of numbers

    Examples
    --------
    >>> from fractions import Fraction
    >>> import cg
    >>> exact_weights(cg.methods["CG3"].tree, 3, [2, 3, 4], Fraction)
    [Fraction(1, 1), Fraction(1, 2), Fraction(1, 2)]
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
        ends = word_weights(tree, inner, trees.children[t - 1], letters, one)
        add_letter(t, [ends[at] for at in tree.stage_points])
    return [
        word_weights(tree, last, trees.children[t - 1], letters, one)[tree.result] for t in indices
    ]


def word_weights(
    tree: PointTree,
    points: Sequence[int],
    word: Sequence[int],
    letters: Mapping[int, Sequence[Any]],
    one: Any,
) -> dict[int, Any]:
    """Return the character χ of each point on a word of trees.

    For each prefix of the word, of length ``end``, χ at point m is the sum over shorter prefixes,
    of length ``begin``, of χ at the parent times the remaining n letters at m, divided by n!.
    """
    zero = one * 0
    prefixes = {START: [one] + [zero] * len(word)}  # χ of each prefix, by its length
    for m in points:
        before = prefixes[tree.points[m].parent]
        after = before.copy()
        for end in range(1, len(word) + 1):
            product = one
            for begin in range(end - 1, -1, -1):
                product = product * letters[word[begin]][m]
                if product == 0:
                    break
                after[end] = after[end] + before[begin] * product / factorial(end - begin)
        prefixes[m] = after
    return {m: row[-1] for m, row in prefixes.items()}


def result_tree(method: HasTree, embedded: bool) -> PointTree:
    """Return the tree of a method with only one of its results."""
    tree = points_of(method)
    if not check_flag("embedded", embedded):
        return replace(tree, embedded_result=None)
    if tree.embedded_result is None:
        raise ValueError(f"embedded: {method!r} has no second result")
    return replace(tree, result=tree.embedded_result, embedded_result=None)


def _rationals(entries: Any, name: str) -> list[Fraction]:
    sequence = isinstance(entries, Iterable) and not isinstance(entries, str | bytes)
    if not sequence or (isinstance(entries, np.ndarray) and entries.ndim == 0):
        raise ValueError(f"{name} must be a sequence of numbers, got {entries!r}")
    return [_rational(entry, name) for entry in entries]


def _rational(entry: Any, name: str) -> Fraction:
    try:
        return read_fraction(entry.item() if isinstance(entry, np.generic) else entry)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise ValueError(f"{name} must hold finite real numbers, got {entry!r}") from None
