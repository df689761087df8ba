"""Regions of linear stability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.catalogue import resolve_method
from cg.construction.methods.method import Method
from cg.construction.methods.stability import stability_function, too_large
from cg.construction.plots.methods import no_splitting
from cg.plot.style import COLOURS, axes_for, verbatim
from cg.support.checks import check_interval

Range = tuple[float, float]

_POINTS = 301
_DASHES = ("solid", "dashed", "dashdot", "dotted")


def stability_region(
    method: str | Method | Sequence[str | Method],
    ax: Any = None,
    *,
    x: Range | None = None,
    y: Range | None = None,
) -> Any:
    """Draw the boundaries ``|R(z)| = 1`` of stability regions of methods, with ``z = h λ``.

    R is the stability function of the classical method for ``y' = λ y``, to which a method reduces
    where flows commute. The regions where ``|R(z)| ≤ 1`` are filled; those of implicit
    methods may have no end.

    Parameters
    ----------
    method
    x, y
        Pairs of float. Ranges of the real and the imaginary part; by default they contain the
        regions.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> ax = cg.plot.stability_region(["CG2", "CF4"])
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['CG2', 'CF4']
    """
    if not isinstance(method, Method | Sequence):
        raise TypeError(f"method must be a method, a name, or a sequence of them, got {method!r}")
    names = [method] if isinstance(method, str | Method) else list(method)
    methods = [no_splitting(resolve_method(name)) for name in names]
    if not methods:
        raise ValueError("method must be one or more methods, got none")
    box = _box(methods) if x is None or y is None else (x, y)
    grid, z = _plane(x, y, box)
    ax = axes_for(ax)
    ax.axhline(0.0, color="#cccccc", linewidth=0.8, zorder=0)
    ax.axvline(0.0, color="#cccccc", linewidth=0.8, zorder=0)
    for k, one in enumerate(methods):
        size = np.abs(growth(one, z))
        colour, dashes = COLOURS[k % len(COLOURS)], _DASHES[k % len(_DASHES)]
        alpha = 0.25 if len(methods) == 1 else 0.12
        ax.contourf(*grid, size, levels=[0.0, 1.0], colors=[colour], alpha=alpha)
        ax.contour(*grid, size, levels=[1.0], colors=[colour], linestyles=[dashes])
        ax.plot([], [], color=colour, linestyle=dashes, label=verbatim(one.name) or "without name")
    ends = {"xlim": grid[0][0, [0, -1]], "ylim": grid[1][[0, -1], 0]}
    ax.set(aspect="equal", xlabel="Re hλ", ylabel="Im hλ", **ends)
    ax.legend(facecolor="white", edgecolor="none", fontsize=8, loc="upper left")
    return ax


def order_star(
    method: str | Method, ax: Any = None, *, x: Range | None = None,
    y: Range | None = None,
) -> Any:  # fmt: skip
    """Draw the order star of a method, where ``|R(z)| > |exp(z)|``.

    Of a method of order p, p + 1 fingers and as many gaps meet at the origin.

    Parameters
    ----------
    method
    x, y
        Pairs of float. Ranges of the real and the imaginary part, by default between ±(1 + stages).

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.plot.order_star("CF4").get_title()
    'CF4'
    """
    one = no_splitting(resolve_method(method))
    reach = 1.0 + one.stages
    grid, z = _plane(x, y, ((-reach, reach), (-reach, reach)))
    ax = axes_for(ax)
    size = np.abs(growth(one, z) * np.exp(-z))
    ax.contourf(*grid, size, levels=[1.0, np.inf], colors=[COLOURS[0]], alpha=0.35)
    ax.contour(*grid, size, levels=[1.0], colors=[COLOURS[0]], linewidths=0.8)
    ax.plot(0.0, 0.0, "k+")
    ax.set(aspect="equal", xlabel="Re z", ylabel="Im z", title=verbatim(one.name) or "without name")
    return ax


def _plane(x: Range | None, y: Range | None, box: tuple[Range, Range]) -> tuple[Any, Any]:
    """Return the coordinates of a grid, and its points z; ranges are those of `box` for None."""
    ends = [box[0] if x is None else check_interval("x", x)]
    ends.append(box[1] if y is None else check_interval("y", y))
    grid = np.meshgrid(*(np.linspace(*end, _POINTS) for end in ends))
    return grid, grid[0] + 1j * grid[1]


def growth(method: Method, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the stability function R(z), the factor of a step of ``y' = λ y`` with ``z = h λ``."""
    if problem := too_large(method):
        raise ValueError(f"method must have fewer stages or digits, got {method!r}: {problem}")
    above, below = (np.array([float(c) for c in p]) for p in stability_function(method))
    with np.errstate(divide="ignore", invalid="ignore"):  # at poles
        return np.asarray(np.polyval(above[::-1], z) / np.polyval(below[::-1], z))


def _box(methods: list[Method]) -> tuple[Range, Range]:
    """Return ranges of both axes with the boundaries of the regions, preferably the finite ones."""
    boundaries = list(map(_boundary, methods))
    whole = [z for z, cut in boundaries if not cut]
    z = np.concatenate([[0j], *(whole or [z for z, _ in boundaries])])
    high = float(z.imag.max())
    margin = 0.15 * max(np.ptp(z.real), high)
    left, right = float(z.real.min() - margin), float(z.real.max() + margin)
    if not whole:
        left, right = min(left, -high / 2), max(right, high / 2)
    return (left, right), (-high - margin, high + margin)


def _boundary(method: Method) -> tuple[NDArray[np.complex128], bool]:
    """Return points near the boundary of a region, and whether it goes on beyond them."""
    reach = 2.0 + method.stages
    for factor in (1.0,) if method.explicit else (4.0, 1.0):
        x, y = np.meshgrid(np.linspace(-2, 1, 241), np.linspace(0.0, 1.5, 121))
        z = np.asarray(factor * reach * (x + 1j * y), dtype=np.complex128)
        stable = np.abs(growth(method, z)) <= 1.0
        edge = np.zeros(z.shape, bool)
        edge[:, 1:] |= stable[:, 1:] != stable[:, :-1]
        edge[1:] |= stable[1:] != stable[:-1]
        cut = bool(edge[-1].any() or edge[:, [1, -1]].any())
        if not cut:
            break
    return z[edge], cut
