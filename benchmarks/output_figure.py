"""The figure of errors between steps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .rival_figure import RC, dress, save_figure

# Colours that stay apart for colour-blind readers (M. Okabe and K. Ito, 2008), and markers.
_STYLES = (
    ("#E69F00", "v"),
    ("#56B4E9", "^"),
    ("#0072B2", "s"),
    ("#009E73", "o"),
    ("#CC79A7", "D"),
    ("#D55E00", "P"),
    ("#000000", "X"),
    ("#999999", "*"),
)


@dataclass(frozen=True)
class OutputError:
    """Errors of one integration.

    Attributes
    ----------
    problem, method : str
    tolerance : float
    at, between : float
        The largest at the steps, and within them.
    ratio : float
        The largest quotient of the error within a step and the larger at its ends.
    """

    problem: str
    method: str
    tolerance: float
    at: float
    between: float
    ratio: float


def draw(errors: list[OutputError], folder: Path) -> None:
    """Draw ``folder/output_errors.png`` and ``.svg``."""
    problems = list(dict.fromkeys(x.problem for x in errors))
    methods = list(dict.fromkeys(x.method for x in errors))
    with mpl.rc_context(RC):
        figure = Figure(figsize=(11.0, 4.4), layout="constrained")
        FigureCanvasAgg(figure)
        panels = np.atleast_1d(figure.subplots(1, len(problems), sharex=True, sharey=True))
        for panel, problem in zip(panels, problems, strict=True):
            ends = np.array([1e-15, 1e-2])
            panel.plot(ends, ends, color="#555555", linewidth=0.9, label="as large")
            panel.plot(ends, 3 * ends, color="#555555", linewidth=0.9, linestyle=(0, (4, 3)),
                       label="three times as large")  # fmt: skip
            for k, method in enumerate(methods):
                colour, marker = _STYLES[k % len(_STYLES)]
                of_method = [x for x in errors if (x.problem, x.method) == (problem, method)]
                style: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 5}
                if k >= len(_STYLES):
                    style["markerfacecolor"] = "white"
                panel.plot([x.at for x in of_method], [x.between for x in of_method], linewidth=0,
                           label=method, **style)  # fmt: skip
            dress(panel, problem, "largest error at steps")
        panels[0].set_ylabel("largest error between steps")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8.5)
        save_figure(figure, folder / "output_errors.png", dpi=110)
