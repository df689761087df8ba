"""Order conditions of Runge–Kutta methods on manifolds.

A method has order q if ``Φ(t) = 1/γ(t)`` for all ordered trees with 2 to q + 1 nodes, (2.4) of
Jackiewicz, Marthinsen and Owren. A method is a tree of points (`cg.structure.points`): the flow to
point m starts at its parent and has weights α_mk on the fields of stages k. Φ is the elementary
weight at the result. The elementary weights at a point are a character χ on words of trees, where
the leftmost child belongs to the first flow::

    χ_m(w) = Σ_{w = u v} χ_parent(m)(u) ℓ_m(v_1) … ℓ_m(v_n) / n!,    n the length of v
    ℓ_m(t) = Σ_k α_mk Φ_k(t),    Φ_k(t) = χ(children of t) at the point of stage k

In a Crouch–Grossman tableau each row is a chain of points with one weight each, so that::

    Φ_r([t_1 … t_μ]) = Σ_{i_1 ≤ … ≤ i_μ} Π_j a_{r,i_j} Φ_{i_j}(t_j) / Π (runs of equal i)!

and ``Φ`` itself has ``b`` in place of ``a_r``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..structure.layout import Layout, Rows, check_length, check_rows, rows_of, unknowns
from . import core_calls
from .counts import (
    MAX_ORDER,
    check_order,
    condition_trees,
    count,
    count_classical,
    right_sides,
    table_rows,
)
from .exact import (
    HasTree,
    ball_residuals_of,
    exact_residuals_of,
    exact_weights,
    residuals_exact,
    result_tree,
)

__all__ = [
    "MAX_ORDER",
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


def pack(a: ArrayLike, b: ArrayLike, rows: Rows | None = None) -> NDArray[np.float64]:
    """Pack the entries of a tableau row by row, ``b`` last.

    Parameters
    ----------
    a : array_like, shape (s, s)
    b : array_like, shape (s,)
    rows : Rows, optional
        The entries to pack; by default the narrowest pattern with all nonzero entries.

    Returns
    -------
    ndarray, shape (unknowns(s, rows),)

    Raises
    ------
    ValueError
        If shapes don't match, an entry isn't finite, or a nonzero entry is outside `rows`.

    Examples
    --------
    >>> pack([[0, 0], [0.5, 0]], [0, 1])
    array([0.5, 0. , 1. ])
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
    """Return full rows of ``a`` and ``b`` from packed entries; padded zeros are ints.

    Examples
    --------
    >>> unpack([0.5, 0.0, 1.0], stages=2)
    ([[0, 0], [0.5, 0]], [0.0, 1.0])
    """
    check_length(x, unknowns(stages, rows))  # before a layout of many stages is made
    *a, b = Layout.tableau(stages, rows).full_rows(x)
    return a, b


def weights(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t)`` for the trees of `condition_trees`; arguments as for `residuals`.

    Examples
    --------
    >>> weights([[0, 0], [0.5, 0]], [0, 1], 2)
    array([1. , 0.5, 0.5])
    """
    order = check_order(order)
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
        Between 1 and `MAX_ORDER`.
    independent : bool, optional
        Only the conditions that don't follow from conditions of lower order.

    Returns
    -------
    ndarray, shape (count(order, independent),)

    Raises
    ------
    ValueError
        If a shape doesn't match, an entry isn't finite, or the order is out of range.

    Examples
    --------
    The midpoint rule has order two, and not three.

    >>> import cg
    >>> residuals([[0, 0], [0.5, 0]], [0, 1], 2)
    array([0., 0., 0.])
    >>> residuals([[0, 0], [0.5, 0]], [0, 1], 3).round(3)
    array([ 0.   ,  0.   ,  0.   ,  0.   , -0.083,  0.083, -0.042, -0.167])
    """
    order = check_order(order)
    return residuals_at(*_packed(*_check_tableau(a, b)), order, independent)


def jacobian(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False, rows: Rows | None = None
) -> NDArray[np.float64]:
    """Return the derivatives of `residuals` with respect to the packed entries.

    Parameters
    ----------
    a, b, order, independent
        As for `residuals`.
    rows : Rows, optional
        The entries to differentiate by; by default the narrowest pattern that contains ``a``.

    Returns
    -------
    ndarray, shape (count(order, independent), unknowns(s, rows))

    Examples
    --------
    >>> jacobian([[0, 0], [0.5, 0]], [0, 1], 2)
    array([[0. , 1. , 1. ],
           [0. , 1. , 1. ],
           [1. , 0. , 0.5]])
    """
    order = check_order(order)
    return jacobian_at(*_packed(*_check_tableau(a, b), rows), order, independent)


def weights_at(
    layout: Layout, x: NDArray[np.float64], order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t)`` for the trees of `condition_trees`; arguments as for `residuals_at`.

    Examples
    --------
    >>> import cg
    >>> layout = cg.methods["CG2"].layout
    >>> weights_at(layout, np.array([0.5, 0.0, 1.0]), 2)
    array([1. , 0.5, 0.5])
    """
    order, x = _check_packed(layout, x, order)
    return core_calls.weights(order, layout, x, _trees(order, independent))


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
        Between 1 and `MAX_ORDER`.
    independent : bool, optional
        As for `residuals`.

    Returns
    -------
    ndarray, shape (count(order, independent),)

    Examples
    --------
    >>> from cg.structure.layout import Layout
    >>> residuals_at(Layout.tableau(2), np.array([0.5, 0.0, 1.0]), 2)
    array([0., 0., 0.])
    """
    order, x = _check_packed(layout, x, order)
    return core_calls.residuals(order, layout, x, _trees(order, independent))


def jacobian_at(
    layout: Layout, x: NDArray[np.float64], order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return the derivatives of `residuals_at` with respect to the packed weights.

    Returns
    -------
    ndarray, shape (count(order, independent), layout.size)

    Examples
    --------
    >>> from cg.structure.layout import Layout
    >>> jacobian_at(Layout.tableau(2), np.array([0.5, 0.0, 1.0]), 1)
    array([[0., 1., 1.]])
    """
    order, x = _check_packed(layout, x, order)
    trees = _trees(order, independent)
    return np.ascontiguousarray(core_calls.jacobian(order, layout, x, trees))


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
        Use the second result of a pair.

    Returns
    -------
    ndarray, shape (count(order, independent),)

    Raises
    ------
    ValueError
        If the order is out of range, or the method has no second result.

    Examples
    --------
    >>> import cg
    >>> [bool(abs(residuals_of(cg.methods["CF4"], order)).max() < 1e-15) for order in (4, 5)]
    [True, False]
    """
    order = check_order(order)
    tree = result_tree(method, embedded)
    layout = Layout.of_tree(tree)
    x = [float(weight) for point in tree.points for weight in point.weights.values()]
    return residuals_at(layout, np.array(x, dtype=np.float64), order, independent)


def _check_tableau(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    checked = []
    for name, value in (("a", a), ("b", b)):
        try:
            if np.ma.is_masked(value):
                raise TypeError("masked")
            given = np.asarray(value)
            if given.dtype.kind not in "iufO":  # a cast would drop imaginary parts
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


def _check_packed(
    layout: Layout, x: NDArray[np.float64], order: int
) -> tuple[int, NDArray[np.float64]]:
    """Check the arguments; compiled code reads ``layout.size`` numbers from `x` unchecked."""
    if not isinstance(layout, Layout):
        raise TypeError(f"layout must be a Layout, got {layout!r}")
    try:
        array = np.asarray(x)
    except ValueError:  # lists of several lengths
        array = np.array(None)
    if np.ma.is_masked(x) or array.dtype.kind not in "iuf" or array.shape != (layout.size,):
        raise ValueError(f"x must have {layout.size} real numbers, got {x!r}")
    return check_order(order), array.astype(np.float64, copy=False)


def _packed(
    a: NDArray[np.float64], b: NDArray[np.float64], rows: Rows | None = None
) -> tuple[Layout, NDArray[np.float64]]:
    rows = rows_of(a) if rows is None else check_rows(rows)
    return Layout.tableau(b.size, rows), pack(a, b, rows)


def _trees(order: int, independent: bool) -> NDArray[np.intc]:
    return np.array(condition_trees(order, independent), dtype=np.intc)
