"""Work-precision diagrams."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from .work_curves import Curve

__all__ = ["RC", "draw"]

# Colours that stay apart for colour-blind readers (M. Okabe and K. Ito, 2008), by order.
_COLOURS = {
    1: "#999999",
    2: "#E69F00",
    3: "#56B4E9",
    4: "#0072B2",
    5: "#009E73",
    6: "#CC79A7",
    7: "#D55E00",
}
_MARKERS = {1: "x", 2: "v", 3: "^", 4: "s", 5: "o", 6: "D", 7: "P"}
_OTHERS: dict[str, dict[str, Any]] = {
    "RKMK-4": {"linestyle": (0, (4, 2)), "marker": "*", "markersize": 7},
    "DOP853, projected": {"linestyle": "-", "marker": "+", "markersize": 7},
    "DOP853, not projected": {"linestyle": (0, (1, 1.5)), "marker": "|", "markersize": 7},
}
RC: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e0e0e0",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "work-precision",
}


def draw(curves: list[Curve], title: str, name: str, folder: Path) -> None:
    """Draw ``folder/name.png`` and ``.svg``: error against time and exponentials, and drift.

    Of each order the most accurate explicit method for the work is drawn in full, the rest
    fainter.

    Parameters
    ----------
    curves : list of Curve
    title : str
    name : str
    folder : Path
    """
    with mpl.rc_context(RC):
        figure = Figure(figsize=(11.0, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(1, 3)
        best = _best(curves)
        for curve in sorted(curves, key=lambda c: c.name in best or not c.own):
            style = _style(curve, curve.name in best)
            error = [p.error for p in curve.points]
            panels[0].plot([1e3 * p.seconds for p in curve.points], error, **style)
            if all(p.exponentials for p in curve.points):
                panels[1].plot([p.exponentials for p in curve.points], error, **style)
            panels[2].plot(error, [p.drift for p in curve.points], **style)
        _dress(
            panels[0],
            f"{title}: error against time",
            "processor time (ms)",
            "largest error at the end",
        )
        _dress(panels[1], "error against exponentials", "exponentials", "")
        _dress(panels[2], "drift off the manifold", "largest error at the end", "")
        panels[1].sharey(panels[0])
        panels[2].invert_xaxis()
        figure.legend(
            handles=_legend(curves, best), loc="outside lower center", ncols=5, fontsize=8.5
        )
        figure.savefig(folder / f"{name}.png", dpi=110, metadata={"Software": None})
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None, "Creator": None})


def _best(curves: list[Curve]) -> set[str]:
    """Return of each order the explicit method of smallest error for given exponentials."""
    found: dict[int, tuple[float, str]] = {}
    for curve in curves:
        if not (curve.own and curve.explicit and curve.points):
            continue
        # errors of an order fall along parallel lines, so any point tells
        heights = sorted(p.error * p.exponentials**curve.order for p in curve.points)
        height = heights[len(heights) // 2]
        if curve.order not in found or height < found[curve.order][0]:
            found[curve.order] = height, curve.name
    return {name for _, name in found.values()}


def _style(curve: Curve, best: bool) -> dict[str, Any]:
    if not curve.own:
        return {"color": "black", "linewidth": 1.3, "zorder": 4, **_OTHERS[curve.name]}
    return {
        "color": _COLOURS[curve.order],
        "marker": _MARKERS[curve.order],
        "markersize": 5 if best else 3,
        "linewidth": 1.8 if best else 0.7,
        "alpha": 1.0 if best else 0.45,
        "linestyle": "-" if curve.explicit else (0, (3, 1.5)),
        "markerfacecolor": None if curve.explicit else "white",
        "zorder": 3 if best else 2,
    }


def _dress(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(base=10.0, numticks=7))
        axis.set_minor_formatter(NullFormatter())
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def _legend(curves: list[Curve], best: set[str]) -> list[Line2D]:
    handles = []
    for order in sorted({c.order for c in curves if c.own}):
        leader = next((c for c in curves if c.name in best and c.order == order), None)
        style = _style(leader, True) if leader else {"color": _COLOURS[order]}
        label = f"order {order}" + (f": {leader.name}, others fainter" if leader else "")
        handles.append(Line2D([], [], label=label, **style))
    handles.append(
        Line2D([], [], color="#555555", linestyle=(0, (3, 1.5)), marker="o",
               markerfacecolor="white", markersize=4, linewidth=0.9, label="implicit")
    )  # fmt: skip
    for curve in curves:
        if not curve.own:
            handles.append(Line2D([], [], label=curve.name, **_style(curve, True)))
    return handles
