"""Plots of numbers over time: invariants of a solution, observables of an ensemble."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.plot.style import axes_for, check_label, check_solution, curve_style, verbatim
from cg.support.arrays import check_finite, real_array

_QUANTILES = ((0.05, 0.95), (0.25, 0.75))


def invariants(
    solution: Any,
    functions: Callable[[Any], Any] | Mapping[str, Callable[[Any], ArrayLike]],
    ax: Any = None,
) -> Any:
    """Draw how far invariants of a solution are from their initial values, against time.

    Parameters
    ----------
    solution
    functions
        A function of the points ``solution.y``, time along the first axis, that returns the values
        of one invariant, or of each by its name, such as the ``invariants`` of problems; or a dict
        with a function of one invariant by each name.

    Returns
    -------
    matplotlib.axes.Axes
        With logarithmic errors; zeros are left out.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> top = cg.problems.HeavyTop()
    >>> run = cg.solve_ivp(top.f, (0, 5), top.y0, frame=top.frame)
    >>> ax = cg.plot.invariants(run, top.invariants)
    >>> ax.get_ylabel()
    'change since the start'
    """
    check_solution(solution)
    if callable(functions):
        values = functions(solution.y)
        if not isinstance(values, Mapping):
            values = {getattr(functions, "__name__", "invariant"): values}
    elif isinstance(functions, Mapping) and all(map(callable, functions.values())):
        values = {name: function(solution.y) for name, function in functions.items()}
    else:
        raise TypeError(f"functions must be a function, or a dict of them, got {functions!r}")
    if not values:
        raise ValueError("functions must have at least one invariant, got none")
    times = np.asarray(solution.t, dtype=np.float64)
    ax = axes_for(ax)
    for name, value in values.items():
        curve = real_array(value, f"functions: {name}")
        if curve.shape != times.shape:
            raise ValueError(
                f"functions must return {len(times)} numbers for {name!r}, got shape {curve.shape}"
            )
        check_finite(curve, f"functions: {name}")
        style = curve_style(ax) | {"marker": ""}
        ax.plot(times, np.abs(curve - curve[0]), label=verbatim(name), **style)
    ax.set_yscale("log", nonpositive="mask")
    ax.set(xlabel="t", ylabel="change since the start")
    ax.legend(frameon=False, fontsize=8)
    return ax


def bands(t: ArrayLike, values: ArrayLike, ax: Any = None, *, label: str | None = None) -> Any:
    """Draw an observable of an ensemble: its median, and bands with half and 90 % of the members.

    Parameters
    ----------
    t
        Times, shape ``(n,)``.
    values
        Shape ``(n, members)``. Numbers of each member, NaN where it has none.
    label
        Name of the median in the legend.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> t = np.linspace(0, 1, 20)
    >>> ax = cg.plot.bands(t, np.outer(t, np.arange(50)), label="angle")
    >>> len(ax.collections), len(ax.lines)
    (2, 1)
    """
    times, numbers = real_array(t, "t"), real_array(values, "values")
    check_finite(times, "t")
    if times.ndim != 1 or numbers.ndim != 2 or len(numbers) != len(times):
        raise ValueError(
            f"values must have shape (n, members) for t of shape (n,), got {numbers.shape} for "
            f"{times.shape}"
        )
    if np.isnan(numbers).all(axis=1).any():
        raise ValueError("values must have at least one number for each time")
    check_label(label)
    ax = axes_for(ax)
    style = curve_style(ax) | {"marker": ""}
    for low, high in _QUANTILES:
        edges = np.nanquantile(numbers, [low, high], axis=1)
        ax.fill_between(times, *edges, color=style["color"], alpha=0.2, linewidth=0)
    name = None if label is None else verbatim(label)
    ax.plot(times, np.nanmedian(numbers, axis=1), label=name, **style)
    ax.set_xlabel("t")
    if label is not None:
        ax.legend(frameon=False, fontsize=8)
    return ax
