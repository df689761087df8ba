"""Figure 4.2: distance from the group over time, and error against stepsize, in double.

The distance is shown as the package integrates and, beside it, of the flows alone.
"""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cg.problems.convergence import observed_order

from .. import top
from ..blocks import Block, Chart, Context, Data, Item, Table, Text, number, places
from ..style import LINES, PALETTE, grid

_STEPS = (4, 8, 10, 16, 32, 64, 128, 256, 512, 1024, 2048)
_DISTANCE_STEPS = 10
_MORE_STEPS = 200  # where rounding has had time to add up
_ABOVE = 8  # keeps the reference line off the curves

# Slopes are fitted where the leading term of the error rules and rounding doesn't yet.
_FLOOR = 2e-13
_MAX_H = 0.07


def compute(context: Context) -> Data:
    """Integrate with many stepsizes.

    By reading and method: ``distance`` from SO(3) at the times ``t`` for h = 0.1, and
    ``distance_flows`` of flows alone; ``long_distance`` and ``long_distance_flows``, the largest
    ones for the stepsize ``long_h``; ``error`` of B at t = 1 for every one of ``h``; ``slope``
    fitted over ``fitted`` points, null where fewer than two lie between rounding and the asymptotic
    range. By reading: ``reference_error`` at t = 1.
    """
    readings: dict[str, dict[str, dict[str, object]]] = {}
    runs = list(product(top.READINGS, top.METHODS))
    h = [1 / steps for steps in _STEPS]
    for done, (reading, method) in enumerate(runs):
        context.progress(done, len(runs))
        error = [top.end_error(reading, method, steps) for steps in _STEPS]
        slope, fitted = _slope(h, error)
        readings.setdefault(reading, {})[method] = {
            "distance": top.errors(reading, method, _DISTANCE_STEPS).distance.tolist(),
            "distance_flows": top.flow_distances(reading, method, _DISTANCE_STEPS).tolist(),
            "long_distance": float(top.errors(reading, method, _MORE_STEPS).distance.max()),
            "long_distance_flows": float(top.flow_distances(reading, method, _MORE_STEPS).max()),
            "error": error,
            "slope": slope,
            "fitted": fitted,
        }
    return {
        "h": h,
        "long_h": 1 / _MORE_STEPS,
        "t": [k / _DISTANCE_STEPS for k in range(_DISTANCE_STEPS + 1)],
        "reference_error": {reading: top.reference_end(reading)[1] for reading in top.READINGS},
        "readings": readings,
    }


def _slope(h: Sequence[float], error: Sequence[float]) -> tuple[float | None, int]:
    pairs = zip(h, error, strict=True)
    used = [(size, value) for size, value in pairs if size <= _MAX_H and value > _FLOOR]
    return (observed_order(*zip(*used, strict=True)) if len(used) > 1 else None), len(used)


def present(data: Data) -> Sequence[Block]:
    """Draw the two graphs for either reading, and tabulate slopes."""
    blocks: list[Block] = [
        Text(
            "Only the first component, B. The distance is half the 2-norm of BᵀB − I, computed "
            "exactly from the doubles. It is shown twice. Left as the package integrates: the "
            "rotations of the flows between two points are multiplied as unit quaternions and "
            "turn the point once; no stage is orthonormalised; each step ends with one "
            "Newton–Schulz step, which takes a distance ε to 3ε²/2 and so removes nothing but "
            "rounding. In the middle the flows themselves, which the paper's geometric exactness "
            "is about: Rodrigues' formula, flow after flow, and nothing else. Their rounding "
            "adds up with the number of flows. The error is the 2-norm at t = 1, against a "
            "reference whose own error is about "
            f"{number(max(data['reference_error'].values()), 2)}."
        )
    ]
    for reading, meaning in top.READINGS.items():
        methods = data["readings"][reading]
        blocks.append(
            Chart(
                f"fig4.2-{reading}",
                lambda figure, methods=methods: _draw(figure, data, methods),  # type: ignore[misc]
                f"Distance of B from SO(3) over time, h = 0.1. Left: with a Newton–Schulz step "
                f"at the end of each step; middle: the flows alone. Right: global error of B at "
                f"t = 1 against the stepsize; the solid line indicates order four. {meaning}",
                _describe(methods),
                size=(12.0, 4.2),
            )
        )
    blocks += [_table(data, reading) for reading in top.READINGS]
    return blocks


def _table(data: Data, reading: str) -> Table:
    """Return the table of distances and slopes of one reading."""
    rows = [
        [
            method,
            number(max(run["distance"]), 2),
            number(max(run["distance_flows"]), 2),
            number(run["long_distance"], 2),
            number(run["long_distance_flows"], 2),
            places(run["slope"], 2),
            number(run["fitted"]),
        ]
        for method, run in data["readings"][reading].items()
    ]
    long = f"h = {number(data['long_h'])}"
    return Table(
        "Largest distance from SO(3) with a Newton–Schulz step and by flows alone, and "
        f"least-squares slope over h ≤ {_MAX_H} and errors above {_FLOOR:g}; {reading}",
        ("method", "h = 0.1", "flows alone", long, "flows alone", "slope", "points"),
        rows,
    )


def _draw(figure: Figure, data: Data, methods: Data) -> None:
    left, middle, right = figure.subplots(1, 3)
    middle.sharey(left)
    panels = ((left, "distance", "with a step towards it"),
              (middle, "distance_flows", "flows alone"))  # fmt: skip
    for axes, key, how in panels:
        for method, run in methods.items():
            axes.plot(data["t"], run[key], label=method, **LINES[method])
        axes.set_xlabel("time t")
        axes.set_ylabel("distance from SO(3) (2-norm)")
        grid(axes, x=False, y=True)
        axes.set_ylim(1e-17, 1e-14)
        mark_roundoff(axes)
        axes.set_title(f"Distance of B(t), {how}", loc="left")
    curves = {method: run["error"] for method, run in methods.items()}
    draw_errors(right, data["h"], curves, {4: _ABOVE * methods["CG4"]["error"][0]})
    right.set_ylabel("global error of B at t = 1 (2-norm)")
    right.set_title("Error against stepsize", loc="left")
    handles = [*right.get_lines(), left.get_lines()[-1]]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)


def draw_errors(
    axes: Axes,
    h: Sequence[float],
    errors: Mapping[str, Sequence[float]],
    references: Mapping[int, float],
) -> None:
    """Plot errors against stepsizes, for each method an error for each of h.

    `references` has by order, at most three, where a reference line of that slope begins at the
    first of h.
    """
    steps = np.array(h)
    for method, error in errors.items():
        axes.plot(steps, error, label=method, **LINES[method])
    black = PALETTE["black"]
    for (order, begin), style in zip(references.items(), ("-", "--", ":"), strict=False):
        line = begin * (steps / steps[0]) ** order
        axes.plot(steps, line, style, color=black, linewidth=1, label=f"order {order}")
    grid(axes, x=True, y=True)
    axes.set_xlabel("stepsize h")


def mark_roundoff(axes: Axes) -> None:
    """Draw a line where the unit roundoff of double is."""
    axes.axhline(
        2.0**-53, color="#666666", linewidth=1, linestyle=(0, (5, 5)), label="roundoff of double"
    )


def _describe(methods: Data) -> str:
    parts = [
        f"{method} stays within {number(max(run['distance']), 2)} of the group, "
        f"{number(max(run['distance_flows']), 2)} by flows alone, and has slope "
        f"{places(run['slope'], 2)}"
        for method, run in methods.items()
    ]
    return "Three panels. " + "; ".join(parts) + "."


ITEMS = (Item("fig4.2", "Figure 4.2", 40, 80, compute, present),)
