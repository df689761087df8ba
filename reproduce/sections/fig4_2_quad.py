"""Figure 4.2, right, in quadruple precision: where rounding in double hides the order no more."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from .. import top
from ..blocks import Block, Chart, Data, Table, Text, number, places
from ..context import Context, Item
from ..quad_orders import FIT, convergence
from ..style import label_panel
from .fig4_2 import draw_errors, mark_roundoff

# Every method as far as a few seconds of one core go.
_MAX_POWER = {"CG4": 16, "CG4a": 16, "CG5a": 14, "CG6a": 11}
_POWERS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16)


def compute(context: Context) -> Data:
    """Return ``readings``, the `quad_orders.convergence` with stepsizes down to 1/65536."""
    steps = {
        method: [2**power for power in _POWERS if power <= _MAX_POWER[method]]
        for method in top.METHODS
    }
    return {"readings": convergence(context, steps)}


def present(data: Data) -> Sequence[Block]:
    """Draw errors against stepsizes, and tabulate slopes."""
    blocks: list[Block] = [
        Text(
            "Fixed-point arithmetic with 114 binary places, about the precision of binary128, with "
            "the 36-digit coefficients of the catalogue for CG4, CG4a and CG5a, and the paper's 8 "
            "digits for CG6a."
        )
    ]
    for reading, part in data["readings"].items():
        methods = part["methods"]
        blocks.append(
            Chart(
                f"fig4.2-quad-{reading}",
                lambda figure, methods=methods: _draw(figure, methods),  # type: ignore[misc]
                f"Global error of B at t = 1 against the stepsize in quadruple precision. "
                f"{top.READINGS[reading]}. The error of the reference is about "
                f"{number(part['reference_error'], 2)}.",
                _describe(methods),
                size=(8.0, 5.0),
            )
        )
        rows = [
            [
                method,
                number(run["h"][-1]),
                number(run["error"][-1]),
                places(run["slope"]),
                places(run["largest_slope"], 2),
            ]
            for method, run in methods.items()
        ]
        blocks.append(
            Table(
                f"Slopes in quadruple precision, {reading}",
                ("method", "smallest h", "error there", f"slope over the last {FIT} points",
                 "largest slope between neighbours"),
                rows,
            )
        )  # fmt: skip
    return blocks


def _draw(figure: Figure, methods: Data) -> None:
    axes = figure.subplots()
    finest = max((run["h"] for run in methods.values()), key=len)
    for method, run in methods.items():
        draw_errors(axes, run["h"], {method: run["error"]}, {})
    # either side of the bundle of curves, so that no line runs along one
    beginnings = {
        4: 8 * methods["CG4"]["error"][0],
        5: methods["CG5a"]["error"][0] / 8,
        6: methods["CG6a"]["error"][0] / 8,
    }
    draw_errors(axes, finest, {}, beginnings)
    mark_roundoff(axes)
    axes.set_ylim(1e-22, 30)
    axes.set_ylabel("global error of B at t = 1 (2-norm)")
    label_panel(axes, "Error in quadruple precision")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper")


def _describe(methods: Data) -> str:
    parts = [
        f"{method} has slope {places(run['slope'])} down to {number(run['error'][-1], 2)}"
        for method, run in methods.items()
    ]
    return "One panel, both axes logarithmic. " + "; ".join(parts) + "."


ITEMS = (Item("fig4.2quad", "Figure 4.2 in quadruple precision", 50, 90, compute, present),)
