"""Calls of compiled elementary weights, residuals and solvers, with checks of memory before.

The bounds of allocated memory follow the declarations in ``fortran/weights.f90``,
``gradient.f90``, ``conditions.f90`` and in the solvers. Change them together.
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

Vector = NDArray[np.float64]
Trees = NDArray[np.intc]


def weights(order: int, layout: Layout, x: Vector, trees: Trees) -> Vector:
    """Return ``Φ(t)`` of the first result, shape (m,), at packed weights x, shape (layout.size,).

    `trees` are the indices of trees with at most ``order + 1`` nodes, intc of shape (m,).
    MemoryError if the compiled call would allocate more memory than there is.
    """
    with reserved(_evaluation(order, layout, trees.size), _what("weights", order, layout)):
        phi: Vector = _core_r64.weights(order, layout.code, x, trees)
    return phi


def residuals(
    order: int, layout: Layout, x: Vector, trees: Trees, owner: Trees | None = None
) -> Vector:
    """Return the residuals, shape (m,); the arguments are those of `weights`.

    `owner`, intc of shape (m,), is the result that each condition belongs to: 0 for the first one.
    """
    owner = np.zeros_like(trees) if owner is None else owner
    with reserved(_evaluation(order, layout, trees.size), _what("residuals", order, layout)):
        values: Vector = _core_r64.residuals(order, layout.code, x, trees, owner=owner)
    return values


def residuals_quad(
    order: int, layout: Layout, x: quads.Quads, trees: Trees, owner: Trees
) -> quads.Quads:
    """Return the residuals in real(16), shape (m, 16)."""
    core = quads.core("a residual in real(16)")
    with reserved(_evaluation(order, layout, trees.size, 16), _what("residuals", order, layout)):
        values = core.residuals(order, layout.code, x.T, trees, owner=owner)
    return np.ascontiguousarray(values.T)


def jacobian(
    order: int, layout: Layout, x: Vector, trees: Trees, owner: Trees | None = None
) -> Vector:
    """Return the derivatives of `residuals`, shape (m, layout.size)."""
    owner = np.zeros_like(trees) if owner is None else owner
    with reserved(_derivatives(order, layout, trees.size), _what("the Jacobian", order, layout)):
        matrix: Vector = _core_r64.jacobian(order, layout.code, x, trees, owner=owner)
    return matrix


def fit_lmdif(
    order: int,
    layout: Layout,
    x: NDArray[Any],
    trees: Trees,
    tolerance: NDArray[Any],
    maxfev: int,
    stop_flag: StopFlag,
) -> tuple[Any, ...]:
    """Call the compiled lmdif; return x, f, info and nfev, in the kind of x.

    x has shape (n,), or (16, n) in real(16). There are at least as many trees as unknowns.
    `tolerance`, shape (1,) or (16, 1), is that for the sum of squares and for x.
    """
    m, n = trees.size, layout.size
    core, size = (_core_r64, 8) if x.ndim == 1 else (quads.core("lmdif in real(16)"), 16)
    needed = _evaluation(order, layout, m, size) + size * (m * n + 6 * m + 16 * n)
    with reserved(needed, _what("lmdif", order, layout)):
        results: tuple[Any, ...] = core.fit_lmdif(
            order, layout.code, x, trees, tolerance, tolerance, maxfev, stop_flag
        )
    return results


def fit_minimum_norm(
    order: int,
    layout: Layout,
    x: Vector,
    trees: Trees,
    owner: Trees,
    free: Trees,
    *arguments: Any,
) -> tuple[Any, ...]:
    """Call the compiled solver of `cg.construction.solvers.minimum_norm`; return its results.

    The first arguments are those of `residuals`; `free` are the indices, from 1, of the unknowns
    that may move, intc of shape (k,).
    """
    m, n, k = trees.size, layout.size, free.size
    solver = 2 * m * (n + k) + 2 * m * m + (k + 33 * m) + 8 * (m + n + k)
    accurate = m * (2 * k + m)  # of the QR factorisation, with a transposed copy
    needed = _derivatives(order, layout, m) + 8 * (solver + accurate)
    with reserved(needed, _what("the fit", order, layout)):
        results: tuple[Any, ...] = _core_r64.fit_minimum_norm(
            order, layout.code, x, trees, owner, free, *arguments
        )
    return results


def _what(name: str, order: int, layout: Layout) -> str:
    return f"{name} of order {order} with {layout.stages} stages and {layout.size} unknowns"


def _trees(order: int) -> int:
    """Return the number of trees with at most `order` nodes."""
    return sum(catalan(nodes - 1) for nodes in range(1, order + 1))


def _evaluation(order: int, layout: Layout, conditions: int, size: int = 8) -> int:
    """Bound the bytes of an evaluation: `weights_t`, conditions, and copies by f2py."""
    points, ends, inner = len(layout.parents), len(layout.code), _trees(order)
    numbers = inner * (3 * points + layout.segments + 1) + 8 * points + 3 * layout.size
    integers = 2 * order * _trees(order + 1) + 8 * ends + 4 * conditions
    return size * (numbers + 3 * conditions) + 4 * integers


def _derivatives(order: int, layout: Layout, conditions: int) -> int:
    """Bound the bytes of `jacobian`: all arrays of `weights_jacobian` at once."""
    inner, points, segments = _trees(order), len(layout.parents), layout.segments
    adjoint = inner * (layout.size + conditions * segments)  # and the weights' own derivatives
    chain = inner * (3 * points + segments) + (order + 6) * points  # seeds, or the sweep
    jac = conditions * (layout.size + 4 * segments + 4)
    return _evaluation(order, layout, conditions) + 8 * (adjoint + chain + jac)
