"""Calls of compiled elementary weights and residuals, with checks of memory before.

The bounds of allocated memory follow the declarations in ``fortran/conditions/weights.f90`` and
``conditions.f90``. Change them together.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg import _core_r64
from cg.construction.layouts import Layout
from cg.construction.trees import catalan
from cg.support import quads
from cg.support.memory import check_memory

Vector = NDArray[np.float64]
Trees = NDArray[np.intc]


def residuals(
    order: int, layout: Layout, x: NDArray[Any], trees: Trees, owner: Trees | None = None
) -> NDArray[Any]:
    """Return the residuals at packed weights x, (n,) doubles or (n, 16) binary128 numbers, as x.

    `owner`, intc of shape (m,), is the result that each condition belongs to: 0 for the first one.
    """
    owner = np.zeros_like(trees) if owner is None else owner
    core, size = (_core_r64, 8) if x.ndim == 1 else (quads.core("a residual in real(16)"), 16)
    needed = evaluation_bytes(order, layout, trees.size, size)
    check_memory(needed, described("residuals", order, layout))
    values = core.residuals(order, layout.code, x.T, trees, owner=owner)
    return np.ascontiguousarray(values.T)


def jacobian(
    order: int, layout: Layout, x: Vector, trees: Trees, owner: Trees | None = None
) -> Vector:
    """Return the derivatives of `residuals`, shape (m, layout.size)."""
    owner = np.zeros_like(trees) if owner is None else owner
    needed = derivatives_bytes(order, layout, trees.size)
    check_memory(needed, described("the Jacobian", order, layout))
    return np.asarray(_core_r64.jacobian(order, layout.code, x, trees, owner=owner))


def described(name: str, order: int, layout: Layout) -> str:
    """Return what a call computes, for its error message."""
    return f"{name} of order {order} with {layout.stages} stages and {layout.size} unknowns"


def _trees(order: int) -> int:
    """Return the number of trees with at most `order` nodes."""
    return sum(catalan(nodes - 1) for nodes in range(1, order + 1))


def evaluation_bytes(order: int, layout: Layout, conditions: int, size: int = 8) -> int:
    """Bound the bytes of an evaluation: `weights_t`, conditions, and copies by f2py."""
    points, ends, inner = len(layout.parents), len(layout.code), _trees(order)
    numbers = inner * (3 * points + layout.segments + 1) + 8 * points + 3 * layout.size
    integers = 8 * ends + 4 * conditions
    return size * (numbers + 3 * conditions) + 4 * integers


def derivatives_bytes(order: int, layout: Layout, conditions: int) -> int:
    """Bound the bytes of `jacobian`: all arrays of `conditions.f90` at once."""
    inner, points, segments = _trees(order), len(layout.parents), layout.segments
    adjoint = inner * (layout.size + conditions * segments)  # and the weights' own derivatives
    chain = inner * (3 * points + segments) + (order + 6) * points  # seeds, or the sweep
    jac = conditions * (layout.size + 4 * segments + 4)
    return evaluation_bytes(order, layout, conditions) + 8 * (adjoint + chain + jac)
