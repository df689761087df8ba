"""The one door to compiled weights and conditions of methods: memory is asked for before.

Bounds of what calls allocate follow the declarations in ``fortran/weights.f90``,
``gradient.f90``, ``conditions.f90`` and those of the solvers: change them together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core_r64
from ..structure.layout import Layout
from ..support import quads
from ..support.memory import reserved
from ..support.parallel import StopFlag
from ..trees.ordered import catalan

__all__ = [
    "fit_lmdif",
    "fit_minimum_norm",
    "jacobian",
    "residuals",
    "residuals_quad",
    "weights",
]

Vector = NDArray[np.float64]
Trees = NDArray[np.intc]


def weights(order: int, layout: Layout, x: Vector, trees: Trees) -> Vector:
    """Return ``Φ(t)`` of the first result, shape (m,).

    Parameters
    ----------
    order : int
        Between 1 and `cg.conditions.MAX_ORDER`.
    layout : Layout
    x : ndarray, shape (layout.size,)
    trees : ndarray of intc, shape (m,)
        Indices, with at most ``order + 1`` nodes each.

    Raises
    ------
    MemoryError
        If there isn't enough for what the compiled call allocates.
    """
    with reserved(_evaluation(order, layout, trees.size), _what("weights", order, layout)):
        found: Vector = _core_r64.weights(order, layout.code, x, trees)
    return found


def residuals(
    order: int, layout: Layout, x: Vector, trees: Trees, owner: Trees | None = None
) -> Vector:
    """Return the residuals, shape (m,); as `weights`, with the owner of each condition."""
    owner = np.zeros_like(trees) if owner is None else owner
    with reserved(_evaluation(order, layout, trees.size), _what("residuals", order, layout)):
        found: Vector = _core_r64.residuals(order, layout.code, x, trees, owner=owner)
    return found


def residuals_quad(
    order: int, layout: Layout, x: quads.Quads, trees: Trees, owner: Trees
) -> quads.Quads:
    """Return the residuals in real(16), shape (m, 16)."""
    core = quads.core("a residual in real(16)")
    with reserved(_evaluation(order, layout, trees.size, 16), _what("residuals", order, layout)):
        found = core.residuals(order, layout.code, x.T, trees, owner=owner)
    return np.ascontiguousarray(found.T)


def jacobian(
    order: int, layout: Layout, x: Vector, trees: Trees, owner: Trees | None = None
) -> Vector:
    """Return the derivatives of `residuals`, shape (m, layout.size)."""
    owner = np.zeros_like(trees) if owner is None else owner
    with reserved(_derivatives(order, layout, trees.size), _what("the Jacobian", order, layout)):
        found: Vector = _core_r64.jacobian(order, layout.code, x, trees, owner=owner)
    return found


def fit_lmdif(
    order: int,
    layout: Layout,
    x: NDArray[Any],
    trees: Trees,
    tolerance: NDArray[Any],
    maxfev: int,
    stop_flag: StopFlag,
) -> tuple[Any, ...]:
    """Return what the compiled lmdif ends with: x, f, info, nfev; in the kind of x.

    Parameters
    ----------
    order, layout, trees
        As for `weights`; at least as many trees as unknowns.
    x : ndarray, shape (n,), or in real(16) (16, n)
    tolerance : ndarray, shape (1,) or (16, 1)
        For the sum of squares and for x.
    maxfev : int
    stop_flag : ndarray of intc, shape (1,)
    """
    m, n = trees.size, layout.size
    core, size = (_core_r64, 8) if x.ndim == 1 else (quads.core("lmdif in real(16)"), 16)
    needed = _evaluation(order, layout, m, size) + size * (m * n + 6 * m + 16 * n)
    with reserved(needed, _what("lmdif", order, layout)):
        found: tuple[Any, ...] = core.fit_lmdif(
            order, layout.code, x, trees, tolerance, tolerance, maxfev, stop_flag
        )
    return found


def fit_minimum_norm(
    order: int,
    layout: Layout,
    x: Vector,
    trees: Trees,
    owner: Trees,
    free: Trees,
    *arguments: Any,
) -> tuple[Any, ...]:
    """Return what the compiled solver of `cg.construction.solvers.minimum_norm` ends with.

    Parameters
    ----------
    order, layout, x, trees, owner
        As for `residuals`.
    free : ndarray of intc, shape (k,)
        Indices, from 1, of the unknowns that may move.
    *arguments
        The other arguments of ``fit_minimum_norm``.
    """
    m, n, k = trees.size, layout.size, free.size
    solver = 2 * m * (n + k) + 2 * m * m + (k + 33 * m) + 8 * (m + n + k)
    accurate = m * (2 * k + m)  # of the QR factorisation, with a transposed copy
    needed = _derivatives(order, layout, m) + 8 * (solver + accurate)
    with reserved(needed, _what("the fit", order, layout)):
        found: tuple[Any, ...] = _core_r64.fit_minimum_norm(
            order, layout.code, x, trees, owner, free, *arguments
        )
    return found


def _what(name: str, order: int, layout: Layout) -> str:
    return f"{name} of order {order} with {layout.stages} stages and {layout.size} unknowns"


def _trees(order: int) -> int:
    """Return how many trees have at most so many nodes."""
    return sum(catalan(nodes - 1) for nodes in range(1, order + 1))


def _evaluation(order: int, layout: Layout, conditions: int, size: int = 8) -> int:
    """Bound the bytes that weights take: `weights_t`, conditions, and what f2py copies."""
    points, ends, inner = len(layout.parents), len(layout.code), _trees(order)
    numbers = inner * (3 * points + layout.segments + 1) + 8 * points + 3 * layout.size
    integers = 2 * order * _trees(order + 1) + 8 * ends + 4 * conditions
    return size * (numbers + 3 * conditions) + 4 * integers


def _derivatives(order: int, layout: Layout, conditions: int) -> int:
    """Bound the bytes that `jacobian` takes: `weights_jacobian` works in all of these at once."""
    inner, points, segments = _trees(order), len(layout.parents), layout.segments
    adjoint = inner * (layout.size + conditions * segments)  # and the weights' own derivatives
    chain = inner * (3 * points + segments) + (order + 6) * points  # seeds, or the sweep
    jac = conditions * (layout.size + 4 * segments + 4)
    return _evaluation(order, layout, conditions) + 8 * (adjoint + chain + jac)
