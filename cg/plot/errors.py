"""Plots of errors against step sizes and against work."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.plot.style import FAINT, axes_for, curve_style
from cg.support.arrays import Array, check_positive, vectors_of_one_length
from cg.support.checks import check_real


def convergence(
    h: ArrayLike, errors: ArrayLike, ax: Any = None, *, label: str | None = None,
    order: float | None = None,
) -> Any:  # fmt: skip
    """Draw errors against step sizes on logarithmic axes; several calls add curves.

    Parameters
    ----------
    h, errors
        Shape ``(n,)``. Positive numbers (`cg.problems.convergence.final_errors`); points with error
        zero are left out.
    label
        Name of the curve in the legend.
    order
        Draw a line of this slope through the last point.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> h = np.array([0.4, 0.2, 0.1, 0.05])
    >>> ax = cg.plot.convergence(h, 3 * h**4, label="CG4a", order=4)
    >>> ax.get_xlabel(), ax.get_xscale()
    ('step size h', 'log')
    """
    sizes, values = _pairs("h", h, errors)
    slope = None if order is None else check_real("order", order)
    ax = _draw(sizes, values, ax, label)
    if slope is not None:
        smallest = np.argmin(sizes)
        guide = values[smallest] * (sizes / sizes[smallest]) ** slope
        ax.plot(sizes, guide, color=FAINT, linewidth=0.9, linestyle=(0, (1, 2)), zorder=0)
        ax.annotate(
            f"order {slope:g}", (sizes[smallest], guide[smallest]), xytext=(9, -7),
            textcoords="offset points", fontsize=8, color="#444444",
        )  # fmt: skip
    ax.set_xlabel("step size h")
    return ax


def work_precision(
    work: ArrayLike, errors: ArrayLike, ax: Any = None, *, label: str | None = None,
    unit: str = "evaluations of f",
) -> Any:  # fmt: skip
    """Draw errors against work on logarithmic axes; several calls add curves.

    Parameters
    ----------
    work, errors
        Shape ``(n,)``. Positive numbers; points with error zero are left out.
    label
        Name of the curve in the legend.
    unit
        Unit of work, such as ``"seconds"``.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> ax = cg.plot.work_precision([100, 200, 400], [1e-3, 6e-5, 4e-6], label="CG4a")
    >>> ax = cg.plot.work_precision([100, 200, 400], [1e-2, 1e-3, 2e-4], ax, label="CG3")
    >>> ax.get_xlabel(), len(ax.lines)
    ('evaluations of f', 2)
    """
    ax = _draw(*_pairs("work", work, errors), ax, label)
    ax.set_xlabel(unit)
    return ax


def _draw(x: Array, errors: Array, ax: Any, label: str | None) -> Any:
    ax = axes_for(ax)
    order = np.argsort(x)
    ax.plot(x[order], errors[order], label=label, **curve_style(ax))
    ax.set(xscale="log", yscale="log", ylabel="error")
    ax.grid(True, which="major", color="#dddddd", linewidth=0.6)
    ax.set_axisbelow(True)
    if label is not None:
        ax.legend(frameon=False, fontsize=8)
    return ax


def _pairs(name: str, x: ArrayLike, errors: ArrayLike) -> tuple[Array, Array]:
    numbers, sizes = vectors_of_one_length(name, x, errors)
    check_positive(name, numbers)
    if not (np.isfinite(sizes).all() and (sizes >= 0).all()):
        raise ValueError(f"errors must be finite and not negative, got {sizes}")
    nonzero = sizes > 0
    if not nonzero.any():
        raise ValueError(f"errors must not all be zero, got {sizes}")
    return numbers[nonzero], sizes[nonzero]
