"""Order conditions in exact and in ball arithmetic, and as equations of SymPy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from cg.construction.conditions.counts import check_order
from cg.construction.conditions.word_weights import EquationSystem, Quantity, Weights
from cg.construction.conditions.words import Condition, condition_words, reciprocal_density
from cg.construction.layouts.layout import Layout, Rows
from cg.construction.layouts.points import PointTree, check_not_sums, points_of, tree_of_rows
from cg.support.balls import to_ball, to_flint, to_fraction, working_precision
from cg.support.checks import check_flag, check_integer
from cg.support.quads import finite_fraction

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
    words = condition_words(check_order(order, None), check_flag("independent", independent))
    layout = Layout.of_tree(tree)
    layout.check_places()
    system = EquationSystem(layout, tuple(Condition(0, word) for word in words))
    x = [weight for point in tree.points for weight in point.weights.values()]
    x.append(Fraction(0))  # from which numbers are made if there are no weights
    if bits is None:
        return tuple(map(to_fraction, system.residuals(list(map(to_flint, x)))))
    with working_precision(check_integer("bits", bits, 2, _MAX_BITS)):
        return tuple(system.residuals(list(map(to_ball, x))))


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
    return [finite_fraction(entry, f"{name} must hold") for entry in entries]


def equations(method: Any, order: int, independent: bool = True) -> list[Any]:
    """Return order conditions as equations of SymPy, in unknown coefficients.

    Parameters
    ----------
    method
        The number of stages of an explicit tableau, at most 100, or a method, of which only the
        pattern of coefficients is used.
    order
        Conditions through this order.
    independent
        Whether conditions that others imply are left out.

    Returns
    -------
    list of sympy.Eq
        ``Φ(t) = 1/γ(t)``, in the sequence of `cg.conditions.residuals`. The symbols are those of
        `cg.diagnose`, counted from 1: ``a_2,1`` and ``b_2`` of a tableau, ``w_3,1`` of point 3
        and stage 1 of other methods. ``sympy.latex`` writes them for a paper, ``sympy.expand``
        multiplies their products of sums out.

    Raises
    ------
    ModuleNotFoundError
        Without SymPy.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.conditions.equations(2, order=2)
    [Eq(b_1 + b_2, 1), Eq(a_2,1*b_2, 1/2)]
    """
    import sympy

    if isinstance(method, int) and not isinstance(method, bool):
        layout: Any = Layout.tableau(check_integer("method", method, 1, 100), Rows.EXPLICIT)
    else:
        layout = getattr(method, "layout", None)
    # methods of Munthe-Kaas, with a tableau, and splitting methods, with drifts, have others
    others = hasattr(method, "tableau") or hasattr(method, "drifts")
    if not isinstance(layout, Layout) or layout.of_time or others:
        kinds = "a Crouch-Grossman or a commutator-free method"
        raise TypeError(f"method must be a number of stages, {kinds}, got {method!r}")
    words = condition_words(check_order(order, None), check_flag("independent", independent))
    weights = Weights(layout, [Quantity(layout.stages, word) for word in words])
    values = weights.evaluate([sympy.Symbol(name) for name in layout.names])
    sides = [sympy.Rational(str(reciprocal_density(word))) for word in words]
    pairs = zip(values, sides, strict=True)
    return [sympy.Eq(value, side, evaluate=False) for value, side in pairs]
