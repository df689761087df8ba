"""Errors in quadruple precision, where rounding hides no order: Figure 4.2, and higher orders."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from cg.construction.catalogue import methods
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.tableau import Tableau

from .. import top
from ..blocks import Block, Chart, Context, Data, Item, Table, Text, number, places
from ..quad_orders import FIT, convergence
from .fig4_2 import draw_errors, mark_roundoff

# Every method as far as a few seconds of one core go.
_MAX_POWER = {"CG4": 16, "CG4a": 16, "CG5a": 14, "CG6a": 11}
_POWERS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16)

_HIGH, _HIGH_POWERS = 6, range(2, 12)
_FLOWS = 2**20  # at most, of an integration of a method of high order: about ten seconds


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
        runs = part["methods"]
        blocks.append(
            Chart(
                f"fig4.2-quad-{reading}",
                lambda figure, runs=runs: _draw(figure, runs),  # type: ignore[misc]
                f"Global error of B at t = 1 against the stepsize in quadruple precision. "
                f"{top.READINGS[reading]}. The error of the reference is about "
                f"{number(part['reference_error'], 2)}.",
                _describe(runs),
                size=(8.0, 5.0),
            )
        )
        blocks.append(_slopes(reading, runs))
    return blocks


def _slopes(reading: str, runs: Data) -> Table:
    rows = [
        [
            name,
            f"{methods[name].order}{', nominal' * methods[name].approximate}",
            number(run["h"][-1]),
            number(run["error"][-1]),
            places(run["slope"]),
            places(run["largest_slope"], 2),
        ]
        for name, run in runs.items()
    ]
    return Table(
        f"Slopes in quadruple precision, {reading}",
        ("method", "order", "smallest h", "error there", f"slope over the last {FIT} points",
         "largest slope between neighbours"),
        rows,
    )  # fmt: skip


def of_high_order() -> list[str]:
    """Return the names of explicit methods of order six and more, by order."""
    kinds = Tableau | CommutatorFree
    explicit = (m for m in methods.values() if isinstance(m, kinds) and m.explicit)
    high = [method for method in explicit if method.order >= _HIGH]
    return [method.name for method in sorted(high, key=lambda m: (m.order, m.name))]


def compute_high(context: Context) -> Data:
    """Return ``readings`` of methods of high order, with stepsizes from 1/4 to 1/2048."""
    steps = {
        name: [2**k for k in _HIGH_POWERS if 2**k * methods[name].exponentials <= _FLOWS]
        for name in of_high_order()
    }
    return {"readings": convergence(context, steps)}


def present_high(data: Data) -> Sequence[Block]:
    """Tabulate slopes of methods of high order."""
    text = (
        "The spinning top again, with every explicit method of the catalogue whose order is six or "
        "more. CG6a is the paper's, as printed: its coefficients satisfy the conditions through "
        "order six approximately, and its error stops falling once that shows. The others satisfy "
        "them to all their digits."
    )
    tables = (_slopes(reading, part["methods"]) for reading, part in data["readings"].items())
    return Text(text), *tables


def _draw(figure: Figure, runs: Data) -> None:
    axes = figure.subplots()
    finest = max((run["h"] for run in runs.values()), key=len)
    for method, run in runs.items():
        draw_errors(axes, run["h"], {method: run["error"]}, {})
    # either side of the bundle of curves, so that no line runs along one
    below = runs["CG6a"]["error"][0] / 32
    beginnings = {4: 8 * runs["CG4"]["error"][0], 5: below, 6: below}
    draw_errors(axes, finest, {}, beginnings)
    mark_roundoff(axes)
    axes.set_ylim(1e-22, 30)
    axes.set_ylabel("global error of B at t = 1 (2-norm)")
    axes.set_title("Error in quadruple precision", loc="left")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper")


def _describe(runs: Data) -> str:
    parts = [
        f"{method} has slope {places(run['slope'])} down to {number(run['error'][-1], 2)}"
        for method, run in runs.items()
    ]
    return "One panel, both axes logarithmic. " + "; ".join(parts) + "."


ITEMS = (
    Item("fig4.2quad", "Figure 4.2 in quadruple precision", 50, 90, compute, present),
    Item("beyond.order", "Methods of order six and more", 100, 100, compute_high, present_high),
)
