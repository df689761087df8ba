"""Order conditions in exact arithmetic, directly from their definition.

This module shares no code with the compiled core, and the tests compare both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from math import factorial
from typing import Any

import numpy as np

from ..structure.layout import Layout
from ..structure.points import START, PointTree, check_not_sums, points_of, tree_of_rows
from ..support.balls import to_ball, to_flint, to_fraction, working_precision
from ..support.checks import check_flag, check_integer
from ..support.parsing import read_fraction
from ..trees.ordered import forest
from .counts import check_order, condition_trees, right_sides

_MAX_BITS = 1_000_000  # with more bits a sum of products would take hours


def exact_tree(a: Any, b: Any) -> PointTree:
    """Return the tree of coefficients as `cg.conditions.residuals` takes them, or ValueError."""
    if isinstance(a, Layout):
        return a.tree(_rationals(b, "b"))
    weights_row = _rationals(b, "b")
    check_not_sums(a)
    if not isinstance(a, Iterable) or isinstance(a, str | bytes):
        raise ValueError(f"a must be a sequence of rows, got {a!r}")
    rows = [_rationals(row, f"row {i} of a") for i, row in enumerate(a, 1)]
    stages = len(weights_row)
    if stages == 0 or len(rows) != stages or any(len(row) != stages for row in rows):
        shape = (len(rows), sorted({len(row) for row in rows}))
        raise ValueError(f"a must have shape ({stages}, {stages}) to match b, got {shape}")
    return tree_of_rows(rows, weights_row)


def tree_residuals(
    tree: PointTree, order: Any, independent: bool, bits: int | None
) -> tuple[Any, ...]:
    """Return ``Φ(t) - 1/γ(t)`` of the result of a tree as fractions, with `bits` as balls."""
    order = check_order(order, None)
    trees, sides = condition_trees(order, independent), right_sides(order, independent)
    if bits is None:
        weights = exact_weights(tree, order, trees, to_flint)
        return tuple(to_fraction(phi) - side for phi, side in zip(weights, sides, strict=True))
    with working_precision(check_integer("bits", bits, 2, _MAX_BITS)):
        weights = exact_weights(tree, order, trees, to_ball)
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


def result_tree(method: Any, embedded: bool) -> PointTree:
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
