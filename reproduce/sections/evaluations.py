"""Order six: f against the number of evaluations, in double and in real(16)."""

import math
from collections.abc import Sequence
from dataclasses import replace

from cg.construction.search.start import RandomStart

from ..blocks import Block, Context, Data, Item, Table, Text, median, number, quartiles
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
    if double stops early, at ``limit``.
    """
    searched = context.results["search6"]
    starts = min(_PLAN.starts, len(searched["f_double"]))
    f = {_PLAN.maxfev: searched["f_double"][:starts]}
    plans = [replace(_PLAN, starts=starts, maxfev=n, refine_below=0.0) for n in COUNTS]
    *double, early = _searches(context, [*plans, STOPPED])
    f |= {n: [start.double.f for start in run] for n, run in zip(COUNTS, double, strict=True)}
    limits = sorted(f)
    ends = zip(f[_PLAN.maxfev], searched["f_quad"][:starts], f[COUNTS[-1]], strict=True)
    ratios = [(quad / double, more / double) for double, quad, more in ends if quad is not None]
    return {
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
    costs = [  # that of a start, in evaluations in double
        plan.maxfev + (_QUAD_COST * plan.refine_maxfev if plan.refine_below else 0)
        for plan in plans
    ]
    total = sum(plan.starts * cost for plan, cost in zip(plans, costs, strict=True))
    context.report_work(0, total)
    runs: list[Sequence[RandomStart]] = []
    before = 0
    for plan, cost in zip(plans, costs, strict=True):

        def report(done: int, _: int, before: int = before, cost: int = cost) -> None:
            context.report_work(before + done * cost, total)

        name = f"limit{plan.maxfev}"
        runs.append(plan.search(name, plan.starts, context, report).starts)
        before += plan.starts * cost
    return runs


def present(data: Data) -> Sequence[Block]:
    """Tabulate f against the limit of evaluations."""
    limits = data["limits"]
    rows = []
    for limit, five in zip(limits, data["f_quartiles"], strict=True):
        rows.append([number(limit), *(number(f, 2) for f in (*five, math.sqrt(five[2])))])
    quad, double = (median(data[f"ratio_{kind}"]) for kind in ("quad", "double"))
    return (
        Text(
            "How far f decreases at order six. The paper doesn't give its limit of evaluations. "
            "At order six lmdif converges slowly: f decreases as long as it runs. After "
            f"{number(limits[-2])} evaluations, the limit that MINPACK proposes for this many "
            f"unknowns, f still falls. {data['limit_quad']} further evaluations in real(16) "
            f"multiply f by {number(min(data['ratio_quad']))} to "
            f"{number(max(data['ratio_quad']))}, median {number(quad)}; as many further in double "
            f"by {number(min(data['ratio_double']))} to {number(max(data['ratio_double']))}, "
            f"median {number(double)}. So slow convergence limits f, not rounding. "
            f"{_stopped(data['stopped'])}"
        ),
        Table(
            f"f by limit of evaluations in double, {data['starts']} starts",
            ("evaluations", "smallest", "lower quartile", "median", "upper quartile", "largest",
             "root of the median"),
            rows,
        ),
    )  # fmt: skip


def _stopped(data: Data) -> str:
    ends = zip(data["f_double"], data["f_quad"], strict=True)
    ways = "; ".join(f"{number(f, 2)} → {number(last, 2)}" for f, last in ends)
    return (
        f"With double stopped near the paper's 1e−6, after {data['limit']} evaluations, and "
        f"{data['limit_quad']} evaluations in real(16), f goes as the paper says: {ways}."
    )


NEEDS = ("search6",)
ITEMS = (Item("evaluations", "Order six: f against evaluations", 80, 37, compute, present, NEEDS),)
