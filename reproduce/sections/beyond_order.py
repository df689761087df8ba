"""Convergence in quadruple precision of methods of order six and more, beside the paper's CG6a."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from cg.construction.catalogue import methods
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.splitting import Splitting

from .. import top
from ..blocks import Block, Chart, Data, Table, Text, number, places
from ..context import Context, Item
from ..quad_orders import FIT, convergence
from ..style import PALETTE, grid, label_panel, lines
from .fig4_2 import draw_errors, mark_roundoff

_LOWEST_ORDER = 6
_POWERS = range(2, 12)
_FLOWS = 2**20
"""Largest number of flows of an integration, about ten seconds of one core."""

_NEAR = 0.1
"""Largest difference between the order and a slope between neighbouring points."""


def select(catalogue: Mapping[str, Method] = methods) -> list[str]:
    """Return the explicit methods of order six and more, by order."""
    chosen = [
        name
        for name, method in catalogue.items()
        if method.order >= _LOWEST_ORDER
        and method.explicit
        and not isinstance(method, MuntheKaas | MagnusMethod | Splitting)
    ]
    return sorted(chosen, key=lambda name: (catalogue[name].order, name))


def compute(context: Context) -> Data:
    """Integrate in quadruple precision with stepsizes from 1/4 down to 1/2048.

    By reading, there is the ``reference_error``, and by method what `quad_orders.order_data`
    returns, ``order``, whether it is only nominal (``approximate``), ``stages``, and ``decades``:
    over how many decades of the error, up from the smallest, slopes between neighbours are within
    ``near`` of the order.
    """
    steps = {
        name: [2**power for power in _POWERS if 2**power * methods[name].exponentials <= _FLOWS]
        for name in select()
    }
    readings = convergence(context, steps)
    for part in readings.values():
        part["methods"] = {
            name: {
                "order": methods[name].order,
                "approximate": methods[name].approximate,
                "stages": methods[name].stages,
                **run,
                "decades": decades(run, methods[name].order),
            }
            for name, run in part["methods"].items()
        }
    return {"near": _NEAR, "readings": readings}


def decades(part: Data, order: int) -> float:
    """Return over how many decades of the error, up from the smallest, slopes show the order."""
    first = len(part["local"])
    while first > 0 and abs(part["local"][first - 1] - order) <= _NEAR:
        first -= 1
    return math.log10(part["error"][first] / part["error"][-1])


def present(data: Data) -> Sequence[Block]:
    """Draw errors and slopes against stepsizes, and tabulate slopes."""
    blocks: list[Block] = [
        Text(
            "The spinning top again, in quadruple precision, with every explicit method of the "
            "catalogue whose order is six or more. CG6a is the paper's, as printed: its "
            "coefficients satisfy the conditions through order six approximately, and its error "
            "stops falling once that shows. The others satisfy them to all their digits."
        )
    ]
    for reading, part in data["readings"].items():
        runs = part["methods"]
        blocks.append(
            Chart(
                f"beyond-order-{reading}",
                lambda figure, runs=runs: _draw(figure, runs),  # type: ignore[misc]
                f"Left: global error of B at t = 1 against the stepsize in quadruple precision. "
                f"Right: slope between neighbouring stepsizes; that of CG6a leaves the panel. "
                f"{top.READINGS[reading]}. The error of the reference, by Taylor series, is about "
                f"{number(part['reference_error'], 2)}.",
                _describe(runs),
                size=(9.6, 5.2),
            )
        )
        rows = [
            [
                name,
                f"{run['order']}, nominal" if run["approximate"] else number(run["order"]),
                number(run["stages"]),
                number(run["h"][-1]),
                number(run["error"][-1]),
                places(run["slope"]),
                places(run["local"][-1]),
                places(run["decades"], 1),
            ]
            for name, run in runs.items()
        ]
        blocks.append(
            Table(
                f"Slopes in quadruple precision, {reading}. The last column counts the decades of "
                f"the error, up from the smallest, in which slopes between neighbours stay within "
                f"{number(data['near'])} of the order",
                ("method", "order", "stages", "smallest h", "error there",
                 f"slope over the last {FIT} points", "last slope", "decades"),
                rows,
            )
        )  # fmt: skip
    return blocks


def _draw(figure: Figure, runs: Data) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    hollow = {name: {**style, "mfc": "none"} for name, style in lines(runs).items()}
    for name, run in runs.items():
        draw_errors(left, run["h"], {name: run["error"]}, {}, hollow)
    finest = max((run["h"] for run in runs.values()), key=len)
    draw_errors(left, finest, {}, _beginnings(runs))
    mark_roundoff(left)
    left.set_ylabel("global error of B at t = 1 (2-norm)")
    label_panel(left, "Error in quadruple precision")
    for name, run in runs.items():
        h = np.array(run["h"])
        right.plot(np.sqrt(h[1:] * h[:-1]), run["local"], **hollow[name])
    orders = sorted({run["order"] for run in runs.values()})
    for order in orders:
        right.axhline(order, color=PALETTE["black"], linewidth=1, zorder=0)
    grid(right, x=True, y=False)
    right.set_ylim(orders[0] - 1, orders[-1] + 1)
    right.set_xlabel("stepsize h")
    right.set_ylabel("slope between neighbours")
    label_panel(right, "Observed order")
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=6)


def _beginnings(runs: Data) -> dict[int, float]:
    """Return where lines of the slope of each order begin, so that they end below all curves."""
    curves = {}
    for order in sorted({run["order"] for run in runs.values()}):
        exact = [run for run in runs.values() if run["order"] == order and not run["approximate"]]
        if exact:
            constants = [run["error"][-1] / run["h"][-1] ** order for run in exact]
            curves[order] = min(constants) / 5 * exact[0]["h"][0] ** order
    return curves


def _describe(runs: Data) -> str:
    parts = [
        f"{name} has slope {places(run['slope'])} down to {number(run['error'][-1], 2)}"
        for name, run in runs.items()
    ]
    return "Two panels, stepsizes logarithmic in both. " + "; ".join(parts) + "."


ITEMS = (
    Item(
        "beyond.order",
        "Beyond the paper: exact methods of order six and more",
        100,
        100,
        compute,
        present,
    ),
)
