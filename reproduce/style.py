"""Style of figures, and how they are written to files."""

import io
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from cg.plot.style import COLOURS
from cg.support.parsing import write_file

from .blocks import Chart

_COLOUR_NAMES = ("blue", "vermilion", "green", "purple", "orange", "sky", "black")
PALETTE: Mapping[str, str] = MappingProxyType(dict(zip(_COLOUR_NAMES, COLOURS, strict=True)))
"""Colours that stay apart for colour-blind readers (M. Okabe and K. Ito, 2008)."""

LINES: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "CG4": {"color": PALETTE["vermilion"], "marker": "o", "linestyle": "-"},
        "CG4a": {"color": PALETTE["blue"], "marker": "s", "linestyle": "--"},
        "CG5a": {"color": PALETTE["green"], "marker": "^", "linestyle": "-."},
        "CG6a": {"color": PALETTE["purple"], "marker": "D", "linestyle": (0, (1, 1))},
    }
)
"""Colour, marker and line of each method in all figures."""

_MIN_SCALE = 72.0  # pixels of a page for an inch of a figure

_RC: dict[Any, Any] = {
    "font.size": 10.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.5,
    "lines.markersize": 5.0,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "legend.handlelength": 3.2,
    "figure.facecolor": "white",
    "svg.fonttype": "path",
}


def grid(axes: Axes, *, x: bool, y: bool) -> None:
    """Make axes logarithmic, with a tick at every decade where there is room."""
    for logarithmic, name, axis in ((x, "x", axes.xaxis), (y, "y", axes.yaxis)):
        if logarithmic:
            getattr(axes, f"set_{name}scale")("log")
            axis.set_major_locator(LogLocator(base=10.0, numticks=9))
            axis.set_minor_formatter(NullFormatter())


def render(chart: Chart, folder: Path) -> str:
    """Draw a chart into ``folder/name.svg`` and ``.png``, and return it for a page.

    The result is an ``svg`` element with ids that are unique on the page.
    """
    # The salt makes the ids inside the file, and so the file itself, the same every time.
    with mpl.rc_context({**_RC, "svg.hashsalt": chart.name}):
        figure = Figure(figsize=chart.size, layout="constrained")
        FigureCanvasAgg(figure)
        chart.draw(figure)
        pixels = io.BytesIO()
        figure.savefig(pixels, format="png", dpi=160, metadata={"Software": None})
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    svg = stream.getvalue()
    write_file(folder / f"{chart.name}.png", pixels.getvalue())
    write_file(folder / f"{chart.name}.svg", svg)
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'\s(xmlns(:\w+)?|version)="[^"]*"', "", body)
    prefix = chart.name.replace(".", "-")
    body = re.sub(r'\bid="', f'id="{prefix}-', body)
    body = re.sub(r'href="#', f'href="#{prefix}-', body)
    body = re.sub(r"url\(#", f"url(#{prefix}-", body)
    # wide enough for letters of 10 points to be legible
    min_width = round(_MIN_SCALE * chart.size[0])
    opening = (
        f'<svg role="img" aria-labelledby="{prefix}-description" style="min-width: {min_width}px"'
    )
    return body.replace("<svg", opening, 1)
