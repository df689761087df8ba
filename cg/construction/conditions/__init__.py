"""Order conditions of Runge–Kutta methods on manifolds.

A method has order q if ``Φ(t) = 1/γ(t)`` for all ordered trees with 2 to q + 1 nodes, (2.4) of
Jackiewicz, Marthinsen and Owren. A method is a tree of points (`cg/construction/points.py`): the
flow to point m starts at its parent and has weights α_mk on the fields of stages k. Φ is the
elementary weight at the result. The elementary weights at a point are a character χ on words of
trees, where the leftmost child belongs to the first flow::

    χ_m(w) = Σ_{w = u v} χ_parent(m)(u) ℓ_m(v_1) … ℓ_m(v_n) / n!,    n the length of v
    ℓ_m(t) = Σ_k α_mk Φ_k(t),    Φ_k(t) = χ(children of t) at the point of stage k

In a Crouch–Grossman tableau each row is a chain of points with one weight each, so that::

    Φ_r([t_1 … t_μ]) = Σ_{i_1 ≤ … ≤ i_μ} Π_j a_{r,i_j} Φ_{i_j}(t_j) / Π (runs of equal i)!

and ``Φ`` itself has ``b`` in place of ``a_r``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.construction.conditions import core_calls
from cg.construction.conditions.counts import (
    MAX_ORDER,
    check_order,
    condition_trees,
    count,
    right_sides,
    table_rows,
)
from cg.construction.conditions.exact import equations, exact_tree, result_tree, tree_residuals
from cg.construction.layouts import Layout, Rows, check_length, check_rows, rows_of, unknowns
from cg.construction.points import PointTree, check_not_sums
from cg.support.arrays import check_finite, real_array
from cg.support.checks import check_choice, check_flag

__all__ = [
    "MAX_ORDER",
    "Rows",
    "check_rows",
    "condition_trees",
    "count",
    "equations",
    "jacobian",
    "pack",
    "residuals",
    "right_sides",
    "table_rows",
    "unknowns",
    "unpack",
    "weights",
]


def pack(a: ArrayLike, b: ArrayLike, rows: Rows | None = None) -> NDArray[np.float64]:
    """Return the entries of a tableau in the pattern `rows`, row by row, ``b`` last.

    >>> pack([[0, 0], [0.5, 0]], [0, 1])
    array([0.5, 0. , 1. ])
    """
    a_array, b_array = _check_tableau(a, b)
    narrowest = rows_of(a_array)
    rows = narrowest if rows is None else check_rows(rows)
    if rows < narrowest:
        raise ValueError(f"a must be zero outside the pattern {rows.name.lower()}, got {a!r}")
    return np.array(
        Layout.tableau(b_array.size, rows).packed([*a_array.tolist(), b_array.tolist()])
    )


def unpack(
    x: Sequence[Any] | NDArray[Any], stages: int, rows: Rows = Rows.EXPLICIT
) -> tuple[list[list[Any]], list[Any]]:
    """Return full rows of ``a`` and ``b`` from packed entries; padded zeros are ints.

    >>> unpack([0.5, 0.0, 1.0], stages=2)
    ([[0, 0], [0.5, 0]], [0.0, 1.0])
    """
    check_length(x, unknowns(stages, rows))  # before a layout of many stages is made
    *a, b = Layout.tableau(stages, rows).full_rows(x)
    return a, b


def weights(
    a: ArrayLike | Layout, b: ArrayLike, order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t)`` for the trees of `condition_trees`; arguments as for `residuals`.

    Examples
    --------
    >>> weights([[0, 0], [0.5, 0]], [0, 1], 2)
    array([1. , 0.5, 0.5])
    """
    order, layout, x = _packed(a, b, order)
    differences = core_calls.residuals(order, layout, x, _trees(order, independent))
    return differences + np.array(right_sides(order, independent), dtype=np.float64)


@overload
def residuals(
    a: Any, b: Any = ..., order: int | None = ..., independent: bool = ..., *,
    embedded: bool = ..., arithmetic: Literal["double"] = ...,
) -> NDArray[np.float64]: ...  # fmt: skip
@overload
def residuals(
    a: Any, b: Any = ..., order: int | None = ..., independent: bool = ..., *,
    embedded: bool = ..., arithmetic: Literal["exact", "balls"],
) -> tuple[Any, ...]: ...  # fmt: skip
def residuals(
    a: Any, b: Any = None, order: int | None = None, independent: bool = False, *,
    embedded: bool = False, arithmetic: str = "double",
) -> Any:  # fmt: skip
    """Return ``Φ(t) - 1/γ(t)`` for all conditions through an order.

    ``residuals(method, order)`` are those of a method, ``residuals(a, b, order)`` those of
    coefficients. Munthe-Kaas, Magnus and splitting methods have other conditions, which their
    methods ``residuals`` evaluate.

    Parameters
    ----------
    a
        Shape ``(s, s)``. A method; any real matrix, where implicit tableaux are those with entries
        on or above the diagonal; or the layout of packed coefficients.
    b
        Shape ``(s,)`` or ``(layout.size,)``. The weights of a tableau, or the packed coefficients.
    order
        Between 1 and `MAX_ORDER`, or 13 in other arithmetics than double.
    independent
        Only the conditions that don't follow from conditions of lower order.
    embedded
        Use the second result of a method that is a pair.
    arithmetic
        One of ``"double"``, ``"exact"``, ``"balls"``. ``"exact"`` takes arguments of
        `fractions.Fraction` as coefficients: integers, floats, ``"119/216"``, ``"0.25"``.
        ``"balls"`` is faster, with midpoints of 512 bits.

    Returns
    -------
    ndarray of float, tuple of Fraction, or tuple of flint.arb
        With count(order, independent) entries.

    Examples
    --------
    The midpoint rule has order two, and not three.

    >>> import crouch_grossman as cg
    >>> residuals([[0, 0], [0.5, 0]], [0, 1], 2)
    array([0., 0., 0.])
    >>> residuals([[0, 0], [0.5, 0]], [0, 1], 3).round(3)
    array([ 0.   ,  0.   ,  0.   ,  0.   , -0.083,  0.083, -0.042, -0.167])

    Heun's method of order three has order two on manifolds.

    >>> a, b = [[0, 0, 0], ["1/3", 0, 0], [0, "2/3", 0]], ["1/4", 0, "3/4"]
    >>> [str(residual) for residual in residuals(a, b, 3, arithmetic="exact")[3:]]
    ['0', '-1/48', '1/48', '0', '0']
    >>> all(0 in ball for ball in residuals(cg.methods["CF4"], 4, arithmetic="balls"))
    True
    """
    check_choice("arithmetic", arithmetic, ("double", "exact", "balls"))
    if not getattr(a, "of_trees", True):
        raise TypeError(f"a has other conditions, see its method residuals: got {a!r}")
    tree = None
    if isinstance(getattr(a, "tree", None), PointTree):
        if b is not None and order is not None:
            raise TypeError(f"b must not be given with a method, got {b!r}")
        order, tree = b if order is None else order, result_tree(a, embedded)
    elif check_flag("embedded", embedded):
        raise ValueError(f"embedded must be False for coefficients, got {embedded!r}")
    elif order is None:
        raise TypeError(f"a must be a method unless b and order are given, got {a!r}")
    if arithmetic != "double":
        tree = exact_tree(a, b) if tree is None else tree
        return tree_residuals(tree, order, independent, arithmetic == "balls")
    if tree is not None:
        a = Layout.of_tree(tree)
        b = [float(weight) for point in tree.points for weight in point.weights.values()]
    order, layout, x = _packed(a, b, order)
    return core_calls.residuals(order, layout, x, _trees(order, independent))


def jacobian(
    a: ArrayLike | Layout, b: ArrayLike, order: int, independent: bool = False,
    rows: Rows | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """Return the derivatives of `residuals` with respect to the packed entries.

    Parameters
    ----------
    a, b, order, independent
        As for `residuals`; for commutator-free methods ``method.layout`` and the packed weights.
    rows
        The entries to differentiate by; by default the narrowest pattern that contains ``a``, or
        those of the layout.

    Returns
    -------
    ndarray, shape (count(order, independent), unknowns)
        The unknowns of a layout are ``layout.names``.

    Examples
    --------
    >>> jacobian([[0, 0], [0.5, 0]], [0, 1], 2)
    array([[0. , 1. , 1. ],
           [0. , 1. , 1. ],
           [1. , 0. , 0.5]])

    The derivatives for a commutator-free method, by the weight of point m on stage k:

    >>> import crouch_grossman as cg
    >>> method = cg.methods["CF3"]
    >>> x = [float(weight.value) for weight in method.coefficients]
    >>> method.layout.names
    ['w_1,1', 'w_2,2', 'w_3,1', 'w_3,3']
    >>> jacobian(method.layout, x, 2, independent=True).round(3)
    array([[1.   , 0.   , 1.   , 1.   ],
           [0.   , 0.75 , 0.   , 0.667]])
    """
    order, layout, x = _packed(a, b, order, rows)
    return np.ascontiguousarray(core_calls.jacobian(order, layout, x, _trees(order, independent)))


def _check_tableau(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    check_not_sums(a)
    matrix, row = real_array(a, "a"), real_array(b, "b")
    check_finite("a", matrix)
    check_finite("b", row)
    if row.ndim != 1 or row.size == 0:
        raise ValueError(f"b must have shape (s,) with s at least 1, got {row.shape}")
    if matrix.shape != (row.size, row.size):
        raise ValueError(
            f"a must have shape ({row.size}, {row.size}) to match b, got {matrix.shape}"
        )
    return matrix, row


def _packed(
    a: ArrayLike | Layout, b: ArrayLike, order: Any, rows: Rows | None = None
) -> tuple[int, Layout, NDArray[np.float64]]:
    """Check the arguments; compiled code reads ``layout.size`` numbers unchecked."""
    order = check_order(order)
    if not isinstance(a, Layout):
        tableau = _check_tableau(a, b)
        rows = rows_of(tableau[0]) if rows is None else check_rows(rows)
        return order, Layout.tableau(tableau[1].size, rows), pack(*tableau, rows)
    if rows is not None:
        raise ValueError(f"rows must be None with a layout, got {rows!r}")
    array = real_array(b, "b")
    if array.shape != (a.size,):
        raise ValueError(f"b must have {a.size} real numbers for the layout, got {b!r}")
    return order, a, array


def _trees(order: int, independent: bool) -> NDArray[np.intc]:
    return np.array(condition_trees(order, independent), dtype=np.intc)
