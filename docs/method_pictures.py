"""Pictures of methods for their pages: the tree of points, and the region of stability."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cg.method import Method
from cg.points import START

BLUE, RED, GREY = "#0072B2", "#D55E00", "#8c8c8c"


def _places(method: Method) -> dict[int, tuple[float, float]]:
    """Return where points are drawn: right by their distance from the start, leaves downwards."""
    children: dict[int, list[int]] = {START: []}
    for m, point in enumerate(method.points):
        children.setdefault(point.parent, []).append(m)
    places: dict[int, tuple[float, float]] = {}
    leaves = 0

    def place(m: int, depth: int) -> float:
        nonlocal leaves
        below = children.get(m, [])
        if below:
            heights = [place(child, depth + 1) for child in below]
            height = heights[0]  # a chain is a straight line
        else:
            height, leaves = float(-leaves), leaves + 1
        places[m] = (depth, height)
        return height

    place(START, 0)
    return places


def tree_figure(method: Method) -> Figure:
    """Draw the tree of points of an explicit method."""
    places = _places(method)
    across = max(x for x, _ in places.values()) + 1
    down = 1 - min(y for _, y in places.values())
    fig = Figure(figsize=(min(9, 1.2 + 0.75 * across), 0.7 + 0.55 * down), layout="constrained")
    ax = fig.subplots()
    ax.axis("off")
    for m, point in enumerate(method.points):
        second = m == method.embedded_result
        ax.annotate(
            "",
            xy=places[m],
            xytext=places[point.parent],
            arrowprops={
                "arrowstyle": "-|>",
                "color": GREY,
                "linestyle": "--" if second else "-",
                "shrinkA": 9,
                "shrinkB": 9,
            },
        )
    stages: dict[int, list[str]] = {}
    for k, at in enumerate(method.stage_points):
        stages.setdefault(at, []).append(str(k + 1))
    for m, (x, y) in places.items():
        result = m == method.result
        named = m in stages
        ax.plot(
            [x],
            [y],
            "o",
            markersize=15 if named else (10 if result else 5),
            color=RED if result else (BLUE if named else GREY),
        )
        ax.annotate(
            ",".join(stages.get(m, [])), (x, y), color="w", ha="center", va="center", fontsize=8
        )
    ax.margins(0.06)
    return fig


def region_figure(method: Method) -> Figure:
    """Draw where ``|R(z)| <= 1``."""
    rows = np.array(method.a, dtype=float)
    weights = np.array(method.b, dtype=float)
    reach = 3.0 + 1.1 * method.order if method.explicit else 12.0
    x, y = np.meshgrid(np.linspace(-reach, 0.5011 * reach, 240), np.linspace(-reach, reach, 240))
    z = (x + 1j * y)[..., None]
    with np.errstate(all="ignore"):
        if method.explicit:
            stages = np.ones((*x.shape, len(weights)), complex)
            for i in range(1, len(weights)):
                stages[..., i] += (z * stages[..., :i]) @ rows[i, :i]
        else:
            one = np.eye(len(weights))
            stages = np.linalg.solve(
                one - z[..., None] * rows, np.ones((*x.shape, len(weights), 1))
            )
            stages = stages[..., 0]
        growth = np.abs(1 + (z * stages) @ weights)
    fig = Figure(figsize=(4.6, 4.6), layout="constrained")
    ax = fig.subplots()
    ax.contourf(x, y, growth, levels=[0, 1], colors=["#bcd9ec"])
    ax.contour(x, y, growth, levels=[1], colors=[BLUE])
    ax.axhline(0, color=GREY, lw=0.7)
    ax.axvline(0, color=GREY, lw=0.7)
    inside = growth <= 1
    if method.explicit and inside.any():  # no more than what there is to see
        left, high = x[inside].min(), np.abs(y[inside]).max()
        ax.set(
            xlim=(1.15 * left - 0.3, max(1.0, x[inside].max() + 0.5)),
            ylim=(-high - 0.5, high + 0.5),
        )
    ax.set(xlabel="Re z", ylabel="Im z", aspect="equal")
    ax.grid(color="#e5e5e5", lw=0.6)
    return fig
