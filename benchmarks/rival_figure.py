"""Work-precision diagrams of all solvers on one problem."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter
from PIL import Image

from .work_curves import QUANTITIES, Curve

# Colours that stay apart for colour-blind readers (M. Okabe and K. Ito, 2008)
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
_MARKERS = ("o", "s", "^", "D", "v", "P", "*", "X", "<", ">")
_DASHES: dict[str, Any] = {
    "pair": "-", "fixed": (0, (5, 1.5)), "rkmk": (0, (1, 1.2)), "rival": (0, (3, 1, 1, 1)),
    "default": "-",
}  # fmt: skip
_KINDS = {
    "pair": "pairs", "fixed": "fixed steps", "rkmk": "Munthe-Kaas", "rival": "others",
    "default": "pairs",
}  # fmt: skip
_SHOWN = {"pair": 4, "fixed": 4, "rkmk": 4, "rival": 4}
_ERROR = 1e-8
RC: dict[Any, Any] = {
    "font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#e0e0e0", "grid.linewidth": 0.5, "legend.frameon": False,
}  # fmt: skip


def _plot(axes: Any, curve: Curve, quantity: str, style: dict[str, Any]) -> None:
    """Plot errors against work, unless the solver doesn't count it."""
    scale = 1e3 if quantity == "time" else 1.0
    work = [scale * QUANTITIES[quantity](p) for p in curve.points]
    if all(work):
        axes.plot(work, [p.error for p in curve.points], **style)


def draw(curves: list[Curve], title: str, name: str, folder: Path) -> None:
    """Draw ``folder/name.png``: error against evaluations, flows and time, and the drift.

    Of each kind the solvers that need least time for an error of 1e-8 are drawn with a name, all
    others as thin grey lines.

    Parameters
    ----------
    curves : list of Curve
    title : str
    name : str
    folder : Path
    """
    styles = _styles(curves)
    with mpl.rc_context(RC):
        figure = Figure(figsize=(11.0, 8.4), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(2, 2).ravel()
        units = ("evaluations", "flows", "processor time (ms)")
        for axes, quantity, unit in zip(panels, QUANTITIES, units, strict=False):
            for curve in curves:
                _plot(axes, curve, quantity, styles[curve.name])
            dress(axes, f"{title}: error against {quantity}", unit, "largest error at the end")
        for curve in curves:
            points = curve.points
            panels[3].plot(
                [p.error for p in points], [p.drift for p in points], **styles[curve.name]
            )
        dress(panels[3], "drift off the manifold", "largest error at the end", "largest drift")
        panels[3].invert_xaxis()
        handles = [
            Line2D([], [], label=f"{curve.name} ({_KINDS[curve.kind]})", **styles[curve.name])
            for curve in curves
            if "marker" in styles[curve.name]
        ]
        handles.append(Line2D([], [], label="all others", **_faint()))
        figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8.5)
        save_figure(figure, folder / f"{name}.png", dpi=90)


def save_figure(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure as a PNG of 32 colours, which takes a quarter of the space of all colours."""
    rendered = BytesIO()
    figure.savefig(rendered, format="png", dpi=dpi)
    Image.open(rendered).convert("RGB").quantize(32).save(path, optimize=True)


def _styles(curves: list[Curve]) -> dict[str, dict[str, Any]]:
    styles: dict[str, dict[str, Any]] = {curve.name: _faint() for curve in curves}
    for kind, most in _SHOWN.items():
        of_kind = [c for c in curves if c.kind == kind and c.points]
        of_kind.sort(key=_height)
        for curve, colour, marker in zip(of_kind[:most], _COLOURS, _MARKERS, strict=False):
            styles[curve.name] = {
                "color": "black" if kind == "rival" else colour, "linestyle": _DASHES[kind],
                "marker": marker, "markersize": 4.5,
                "markerfacecolor": "white" if kind in ("fixed", "rkmk") else None, "linewidth": 1.4,
                "zorder": 3,
            }  # fmt: skip
    return styles


def _height(curve: Curve) -> float:
    """Return the time for an error of 1e-8, or what stands last if that isn't reached."""
    seconds = curve.at(_ERROR, "time")
    return float("inf") if math.isnan(seconds) else seconds


def _faint() -> dict[str, Any]:
    return {"color": "#bdbdbd", "linewidth": 0.6, "zorder": 1}


def dress(axes: Axes, title: str, x: str, y: str = "") -> None:
    """Make both axes logarithmic and write the title and the labels."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(base=10.0, numticks=8))
        axis.set_minor_formatter(NullFormatter())
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
