"""Axes, colours and dashes of all plots, and what they draw of a solution."""

from typing import Any

import numpy as np

from cg.frames.base import Frame
from cg.support.arrays import Array
from cg.support.parsing import visible

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Palette of Okabe and Ito, distinguishable for colour-blind readers."""

FAINT = "#999999"

DASHES: tuple[Any, ...] = ("-", "--", "-.", (0, (1, 1)), (0, (5, 1, 1, 1)), (0, (3, 1)), "-")
_MARKERS = "os^Dv<>"
_CURVE = "cg-curve"

POINTS = 1000  # drawn of a solution with dense output


def axes_for(ax: Any, *, spatial: bool = False) -> Any:
    """Return `ax`, or axes of a new figure if it is None, three-dimensional if `spatial`.

    TypeError if it isn't axes; ValueError if it isn't three-dimensional as it should be.
    """
    from matplotlib.axes import Axes

    if ax is None:
        from matplotlib import pyplot

        projection = "3d" if spatial else None
        return pyplot.figure(layout="constrained").add_subplot(projection=projection)
    if not isinstance(ax, Axes):
        raise TypeError(f"ax must be None or axes of matplotlib, got {ax!r}")
    if spatial and ax.name != "3d":
        raise ValueError(f"ax must be three-dimensional, made with projection='3d', got {ax!r}")
    return ax


def blank(ax: Any) -> None:
    """Remove ticks and frame."""
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)


def curve_style(ax: Any) -> dict[str, Any]:
    """Return colour, dashes and marker of the next curve on these axes."""
    number = sum(line.get_gid() == _CURVE for line in ax.get_lines())
    return {
        "color": COLOURS[number % len(COLOURS)],
        "linestyle": DASHES[(number + number // len(COLOURS)) % len(DASHES)],
        "marker": _MARKERS[number % len(_MARKERS)],
        "markersize": 5,
        "linewidth": 1.4,
        "gid": _CURVE,
    }


def members_of(y: Any, name: str) -> list[Any]:
    """Return the solutions of the members of an ensemble that succeeded, else ``[y]``."""
    if not is_solution(y) or not np.ndim(y.status):
        return [y]
    members = [y[k] for k in np.flatnonzero(y.status >= 0).tolist()]
    if not members:
        raise ValueError(f"{name} must be an ensemble with a member that succeeded, got none")
    return members


def is_solution(y: Any) -> bool:
    """Return whether a value is a solution, not an array of points."""
    return isinstance(getattr(y, "frame", None), Frame)


def check_solution(solution: Any) -> None:
    """Raise an error with the name ``solution`` unless it is one that stores points."""
    if not is_solution(solution):
        raise TypeError(f"solution must be a Solution, got {solution!r}")
    check_stored(solution, "solution")


def opacity_of(members: list[Any]) -> float:
    """Return the opacity of curves of members."""
    return 1.0 if len(members) == 1 else max(0.05, min(0.5, 10 / len(members)))


def check_stored(solution: Any, name: str) -> None:
    """Raise ValueError if a solution stores no points."""
    if getattr(solution, "y", solution) is None:
        raise ValueError(f"{name} must have points, got a solution with store='observed'")


def drawn(y: Any) -> tuple[Frame | None, Array | None, Any]:
    """Return the frame, the times and the points of a solution, if it is dense between steps too.

    Other values, such as arrays, are returned as points alone.
    """
    check_stored(y, "y")
    if not is_solution(y):
        return None, None, y
    if np.ndim(y.status):
        raise ValueError("y must be a solution of one member, such as run[0] of an ensemble")
    if y.sol is None:
        return y.frame, y.t, y.y
    times = np.linspace(y.t[0], y.t[-1], POINTS)
    return y.frame, times, y.sol(times)


def verbatim(text: str) -> str:
    """Return a text with dollar signs escaped for matplotlib."""
    return visible(text).replace("$", r"\$")
