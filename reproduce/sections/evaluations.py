"""Order six: f against the number of evaluations, in double and in real(16)."""

import math
from collections.abc import Sequence
from dataclasses import replace

from matplotlib.figure import Figure

from cg.construction.search.random_search import search
from cg.construction.search.random_starts import RandomStart

from .. import fingerprint
from ..blocks import Block, Chart, Data, Table, Text, number
from ..context import Context, Item, Progress
from ..statistics import median, quartiles
from ..style import PALETTE, grid
from .search import PLANS, Plan

_PLAN = PLANS[6]
_ONCE = _PLAN.unknowns + 1  # a Jacobian by differences, and the step after it

STOPPED = replace(_PLAN, starts=4, maxfev=20 * _ONCE, refine_maxfev=100 * _ONCE)
"""Settings that stop double near the paper's 1e-6, with a high limit in real(16)."""

_QUAD_COST = 80
"""About how many evaluations in double take as long as one in real(16)."""

COUNTS = (10 * _ONCE, 20 * _ONCE, 40 * _ONCE, _PLAN.maxfev + _PLAN.refine_maxfev)
"""Limits of evaluations; the last is that of both phases of the search together."""


def compute(context: Context) -> Data:
    """Run the first starts of the search again, with other ``limits`` of evaluations in double.

    For each limit there are ``f``, by start, and ``f_quartiles``. ``limit_quad`` evaluations in
    real(16) follow the search's own; ``ratio_quad`` is what they multiply f by, ``ratio_double``
    what as many more in double do. ``stopped`` has ``f_double`` and ``f_quad`` of the first starts
    if double stops early, at ``limit``. To compare with: ``paper`` and ``paper_exact``, its values
    of f at orders six and four, ``smallest_exact`` of ours, ``f_printed`` of CG6a, and ``starts``.
    """
    searched = context.results["search6"]
    starts = min(_PLAN.starts, len(searched["f_double"]))
    f = {_PLAN.maxfev: searched["f_double"][:starts]}
    plans = [replace(_PLAN, starts=starts, maxfev=n, refine_below=0.0) for n in COUNTS]
    *double, early = _searches(context, [*plans, STOPPED])
    f |= {n: [start.double.f for start in found] for n, found in zip(COUNTS, double, strict=True)}
    limits = sorted(f)
    ends = zip(f[_PLAN.maxfev], searched["f_quad"][:starts], f[COUNTS[-1]], strict=True)
    ratios = [(quad / double, more / double) for double, quad, more in ends if quad is not None]
    exact = context.results["search4"]
    return {
        "paper": searched["paper"],
        "paper_exact": exact["paper"],
        "smallest_exact": {
            "f_double": min(exact["f_double"]),
            "f_quad": min((f for f in exact["f_quad"] if f is not None), default=None),
        },
        "f_printed": context.results["appendix"]["methods"]["CG6a"]["residuals"]["paper"]["f"],
        "starts": starts,
        "limits": limits,
        "f": [f[limit] for limit in limits],
        "f_quartiles": [quartiles(f[limit]) for limit in limits],
        "limit_quad": _PLAN.refine_maxfev,
        "ratio_quad": [quad for quad, _ in ratios],
        "ratio_double": [double for _, double in ratios],
        "stopped": {
            "limit": STOPPED.maxfev,
            "limit_quad": STOPPED.refine_maxfev,
            "f_double": [start.double.f for start in early],
            "f_quad": [start.quad.f if start.quad else None for start in early],
        },
    }


def _searches(context: Context, plans: Sequence[Plan]) -> list[Sequence[RandomStart]]:
    """Search by one plan after another; report progress in evaluations."""
    costs = [_cost(plan) for plan in plans]
    total = sum(plan.starts * cost for plan, cost in zip(plans, costs, strict=True))
    context.report_work(0, total)
    found, before = [], 0
    for plan, cost in zip(plans, costs, strict=True):

        def report(done: int, _: int, before: int = before, cost: int = cost) -> None:
            context.report_work(before + done * cost, total)

        found.append(_search(context, plan, report))
        before += plan.starts * cost
    return found


def _cost(plan: Plan) -> int:
    """Return the cost of a start, in evaluations in double."""
    return plan.maxfev + (_QUAD_COST * plan.refine_maxfev if plan.refine_below else 0)


def _search(context: Context, plan: Plan, progress: Progress) -> Sequence[RandomStart]:
    arguments = plan.arguments(context.settings.seed)
    digest = fingerprint.digest(**arguments)
    result = search(
        **arguments,
        starts=plan.starts,
        workers=context.workers,
        progress=progress,
        store=context.checkpoints
        / f"limit{plan.maxfev}-seed{context.settings.seed}-{digest}.jsonl",
    )
    return result.starts


def present(data: Data) -> Sequence[Block]:
    """Draw and tabulate f against the limit of evaluations."""
    limits = data["limits"]
    rows = []
    for limit, five in zip(limits, data["f_quartiles"], strict=True):
        cells = (five[0], five[1], five[2], five[3], five[4], math.sqrt(five[2]))
        rows.append([number(limit), *(number(value, 2) for value in cells)])
    quad, double = (median(data[f"ratio_{kind}"]) for kind in ("quad", "double"))
    return (
        Text(
            "How far f decreases at order six. The paper doesn't give its limit of "
            "evaluations. At order six lmdif converges slowly: f decreases as long as it runs. "
            f"{_near(data)} After {number(limits[-2])} evaluations, the limit that MINPACK "
            "proposes for this many unknowns, f is far below that, and still falls."
        ),
        Text(
            f"Extended precision changes little: {data['limit_quad']} further evaluations in "
            f"real(16) multiply f by {number(min(data['ratio_quad']))} to "
            f"{number(max(data['ratio_quad']))}, median {number(quad)}; as many further in double "
            f"by {number(min(data['ratio_double']))} to {number(max(data['ratio_double']))}, "
            f"median {number(double)}. So slow convergence limits f, not rounding."
        ),
        Text(_stopped(data["stopped"])),
        _chart(data),
        Table(
            f"f by limit of evaluations in double, {data['starts']} starts",
            ("evaluations", "smallest", "lower quartile", "median", "upper quartile", "largest",
             "root of the median"),
            rows,
        ),
        Text(_squares_or_norms(data)),
    )  # fmt: skip


def _chart(data: Data) -> Chart:
    first, last = (data["f_quartiles"][k][2] for k in (0, -1))
    return Chart(
        "evaluations",
        lambda figure: _draw(figure, data),
        "f in double against the limit of evaluations, order six: a thin line a start, and "
        "the median. Dotted: the paper's values, taken as f and, squared, as norms.",
        f"The median falls from {number(first, 2)} after {data['limits'][0]} evaluations to "
        f"{number(last, 2)} after {data['limits'][-1]}.",
        size=(8.0, 4.0),
    )


def _squares_or_norms(data: Data) -> str:
    exact, ours, paper = data["paper_exact"], data["smallest_exact"], data["paper"]

    def both(values: Data, power: float = 1) -> str:
        parts = (values[key] for key in ("f_double", "f_quad"))
        return " and ".join(number(v if v is None else v**power, 1) for v in parts)

    return (
        "Sum of squares or norm? The paper says that f, a sum of squares, is reduced to about "
        f"{both(exact)} in double and in extended precision at orders four and five. Our f at "
        f"order four decreases to {both(ours)}, its root to {both(ours, 0.5)}, at the level of "
        "rounding. The paper's values are at the rounding level of the root, the norm that the "
        f"drivers of MINPACK print. If they are norms, the paper's {both(paper)} at order six "
        f"mean f = {both(paper, 2)}. However, CG6a as printed has f = "
        f"{number(data['f_printed'], 2)}, below {number(paper['f_quad'], 1)}, while its root is "
        f"{number(math.sqrt(data['f_printed']), 2)}. The paper may mean both. The verdicts take f "
        "as a sum of squares; the evidence gives the roots as well."
    )


def _stopped(data: Data) -> str:
    ends = zip(data["f_double"], data["f_quad"], strict=True)
    ways = "; ".join(f"{number(f, 2)} → {number(last, 2)}" for f, last in ends)
    return (
        f"With double stopped near the paper's 1e−6, after {data['limit']} evaluations, and "
        f"{data['limit_quad']} evaluations in real(16), f goes as the paper says: {ways}."
    )


def _near(data: Data) -> str:
    """Say after how many evaluations the median is where the paper's f is."""
    target = data["paper"]["f_double"]
    medians = [five[2] for five in data["f_quartiles"]]
    passed = [k for k, value in enumerate(medians) if value <= target]
    if not passed or not passed[0]:
        return f"At none of these limits is the median near the paper's {number(target, 1)}."
    before, after = (data["limits"][k] for k in (passed[0] - 1, passed[0]))
    return (
        f"The median passes the paper's {number(target, 1)} between {before} and {after} "
        f"evaluations, {before // _ONCE} to {after // _ONCE} Jacobians."
    )


def _draw(figure: Figure, data: Data) -> None:
    axes = figure.subplots()
    limits = data["limits"]
    for f in zip(*data["f"], strict=True):
        axes.plot(limits, f, color=PALETTE["sky"], linewidth=0.8)
    axes.get_lines()[0].set_label("a start")
    medians = [five[2] for five in data["f_quartiles"]]
    axes.plot(limits, medians, color=PALETTE["blue"], marker="s", label="median")
    for power, how, style in ((1, "as f", ":"), (2, "as a norm", "-.")):
        for key, phase in (("f_double", "double"), ("f_quad", "real(16)")):
            axes.axhline(
                data["paper"][key] ** power, linestyle=style, linewidth=1.2,
                color=PALETTE["vermilion" if key == "f_double" else "purple"],
                label=f"paper, {phase}, {how}",
            )  # fmt: skip
    grid(axes, x=True, y=True)
    axes.set_xticks(limits[:-1], labels=map(str, limits[:-1]))  # the last two are close
    axes.tick_params(axis="x", which="minor", bottom=False)
    axes.set_xlabel("limit of evaluations")
    axes.set_ylabel("f = sum of squared residuals")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper")


ITEMS = (
    Item(
        "evaluations",
        "Order six: f against evaluations",
        80,
        37,
        compute,
        present,
        needs=("appendix", "search4", "search6"),
    ),
)
