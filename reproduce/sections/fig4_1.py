"""Figure 4.1: global error of either component of the spinning top over time, h = 0.1."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from .. import top
from ..blocks import Block, Chart, Context, Data, Item, Table, Text, number
from ..style import LINES, grid

STEPS = 10
"""Steps over [0, 1]: the paper's h = 0.1."""

_COMPONENTS = {"rotation": "B", "momentum": "ω"}


def compute(context: Context) -> Data:
    """Integrate with the four methods, for both readings of the initial momentum.

    By reading, there are ``reference_error`` and by method the lists ``rotation`` and ``momentum``
    of 2-norms of errors at every time of ``t``.
    """
    readings = {}
    for done, reading in enumerate(top.READINGS):
        context.progress(done, len(top.READINGS))
        runs = {method: top.errors(reading, method, STEPS) for method in top.METHODS}
        readings[reading] = {
            "reference_error": top.reference_error(reading, STEPS),
            "methods": {
                method: {name: getattr(run, name).tolist() for name in _COMPONENTS}
                for method, run in runs.items()
            },
        }
    return {"h": 1 / STEPS, "t": [k / STEPS for k in range(STEPS + 1)], "readings": readings}


def present(data: Data) -> Sequence[Block]:
    """Draw both readings, the paper's words first, and tabulate the errors at t = 1."""
    blocks: list[Block] = [
        Text(
            "The paper gives neither inertia, mass, nor length of the top. We take "
            "I = diag(7, 7, 2)/8, M = 1, g = 9.81 and L = √3/2, an example of the "
            "co-author's program DiffMan. The paper calls ω(0) an angular momentum; that example "
            "starts from an angular velocity. Both readings are shown. Errors are 2-norms of "
            "matrices. At t = 0 all errors are rounding of the initial value and left out."
        )
    ]
    for reading, meaning in top.READINGS.items():
        part = data["readings"][reading]
        blocks.append(
            Chart(
                f"fig4.1-{reading}",
                lambda figure, part=part: _draw(figure, data["t"], part["methods"]),  # type: ignore[misc]
                f"Global error over time, h = {data['h']}, {meaning}",
                _describe(part["methods"]),
            )
        )
        blocks.append(
            Text(
                f"Reference: Taylor series in ball arithmetic with 256 bits; two orders and "
                f"stepsizes differ by at most {number(part['reference_error'], 2)} at these times."
            )
        )
    rows = [
        [method, *(number(data["readings"][r]["methods"][method][c][-1])
                   for r in top.READINGS for c in _COMPONENTS)]
        for method in top.METHODS
    ]  # fmt: skip
    header = [f"{label}, {reading}" for reading in top.READINGS for label in _COMPONENTS.values()]
    blocks.append(Table("Global error at t = 1, h = 0.1", ("method", *header), rows))
    return blocks


def _draw(figure: Figure, t: Sequence[float], methods: Data) -> None:
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (component, label) in zip(panels, _COMPONENTS.items(), strict=True):
        for method, run in methods.items():
            axes.plot(t[1:], run[component][1:], label=method, **LINES[method])
        grid(axes, x=False, y=True)
        axes.set_xlabel("time t")
        axes.set_xlim(0, 1.03)
        axes.set_title(f"Component {label}(t)", loc="left")
    panels[0].set_ylabel("global error (2-norm)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)


def _describe(methods: Data) -> str:
    parts = [
        f"{method} ends at {number(run['rotation'][-1], 2)} in B and "
        f"{number(run['momentum'][-1], 2)} in ω"
        for method, run in methods.items()
    ]
    return "Two panels, logarithmic error over time. " + "; ".join(parts) + "."


ITEMS = (Item("fig4.1", "Figure 4.1", 30, 70, compute, present),)
