"""The computer search of Section 3.2: the values of f and the methods found."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cg.construction.conditions import unknowns
from cg.construction.layouts import Layout
from cg.construction.methods.tableau import Tableau
from cg.construction.search.random_search import SearchResult, search
from cg.construction.search.start import RandomStart
from cg.support.shared_numbers import LmdifStatus

from .. import fingerprint
from ..blocks import Block, Chart, Context, Data, Item, Progress, Table, Text, number, quartiles
from ..coefficients import coefficient_table, largest_coefficient, method_data
from ..style import PALETTE, grid

_SHOWN = 3
_MIN_F = 1e-70  # smaller values are drawn here


@dataclass(frozen=True)
class Plan:
    """Settings of one search, with the numbers of starts of the default and the extensive one.

    Starts with at most `refine_below` in double are refined in real(16), with `refine_maxfev`
    evaluations. `paper_double` and `paper_quad` are the values of f that the paper gives.
    """

    order: int
    stages: int
    starts: int
    full_starts: int
    maxfev: int
    refine_below: float
    refine_maxfev: int
    paper_double: float
    paper_quad: float

    @property
    def unknowns(self) -> int:
        """Number of coefficients."""
        return unknowns(self.stages)

    def arguments(self, seed: int) -> dict[str, Any]:
        """Return the arguments of `cg.search` except the number of starts."""
        return {
            "order": self.order,
            "stages": self.stages,
            "seed": seed,
            "algorithm": "lmdif",
            "maxfev": self.maxfev,
            "refine_below": self.refine_below,
            "refine_maxfev": self.refine_maxfev,
        }

    def search(self, name: str, starts: int, context: Context, progress: Progress) -> SearchResult:
        """Search, or continue a search from its store, whose file is called after `name`."""
        arguments = self.arguments(context.settings.seed)
        file = f"{name}-seed{context.settings.seed}-{fingerprint.digest(**arguments)}.jsonl"
        return search(
            **arguments,
            starts=starts,
            workers=context.workers,
            store=context.checkpoints / file,
            progress=progress,
        )


PLANS = {
    4: Plan(4, 5, 1000, 20_000, 3_200, 1e-12, 320, 1e-15, 1e-31),
    # at order five lmdif follows long valleys: most zeros take 1e4 to 1e5 evaluations
    5: Plan(5, 9, 240, 4_800, 100_000, 1e-12, 1840, 1e-15, 1e-31),
    # this search has found no zero, so all starts are refined, for a few Jacobians each
    6: Plan(6, 16, 16, 320, 27_400, 1.0, 822, 1e-6, 1e-8),
}


def compute(plan: Plan, context: Context) -> Data:
    """Search with the starts of the settings.

    By start there are ``f_double``, ``nfev_double``, ``info_double``, ``f_quad``, ``nfev_quad``
    (null where not refined) and ``exact``; in all, how many starts are ``at_limit`` of evaluations
    in double, how many exact methods are ``distinct``, how many of these have
    ``abscissae_in_unit_interval``, their ``largest_coefficients``, the chosen ``methods``, and
    ``best``, the start with the smallest residual. ``settings`` and the ``paper``'s values of f are
    there to compare.
    """
    count = plan.full_starts if context.settings.full else plan.starts
    result = plan.search(f"search{plan.order}", count, context, context.progress)
    starts = result.starts
    refined = [start.quad for start in starts]
    f_double = [start.double.f for start in starts]
    f_quad = [phase.f if phase else None for phase in refined]
    settings = asdict(result.settings)
    settings["rows"] = settings["rows"].name.lower()
    tableaux = [method for method in result.methods if isinstance(method, Tableau)]
    return {
        "settings": settings,
        "paper": {"f_double": plan.paper_double, "f_quad": plan.paper_quad},
        "f_double": f_double,
        "nfev_double": [start.double.nfev for start in starts],
        "info_double": [start.double.info for start in starts],
        "at_limit": sum(start.double.info == LmdifStatus.TOO_MANY_EVALUATIONS for start in starts),
        "f_quad": f_quad,
        "nfev_quad": [phase.nfev if phase else None for phase in refined],
        "exact": [start.exact for start in starts],
        "f_double_quartiles": quartiles(f_double),
        "f_quad_quartiles": quartiles([f for f in f_quad if f is not None]),
        "distinct": len(tableaux),
        "abscissae_in_unit_interval": sum(map(_in_unit_interval, tableaux)),
        "largest_coefficients": [largest_coefficient(method) for method in tableaux],
        "methods": [method_data(method, plan.order) for method in _chosen(plan.order, tableaux)],
        "best": _best(plan, result.best),
    }


def _chosen(order: int, methods: Sequence[Tableau]) -> Sequence[Tableau]:
    """Choose methods as the paper does: abscissae in [0, 1] at order four, small coefficients."""
    if order == PLANS[4].order:
        methods = sorted(methods, key=lambda method: not _in_unit_interval(method))
    return methods[:_SHOWN]


def _in_unit_interval(method: Tableau) -> bool:
    return all(0 <= entry <= 1 for entry in method.abscissae)


def _best(plan: Plan, start: RandomStart) -> dict[str, Any]:
    method = Tableau.from_layout(Layout.tableau(plan.stages), start.x, name=f"start {start.index}")
    return {
        "start": start.index,
        "f": start.quad.f if start.quad else start.double.f,
        "max_residual": start.max_residual,
        "exact": start.exact,
        **method_data(method, plan.order),
    }


def present(plan: Plan, data: Data) -> Sequence[Block]:
    """Draw the distribution of f, and list the chosen methods."""
    settings, total, exact = data["settings"], len(data["exact"]), sum(data["exact"])
    refined = sum(f is not None for f in data["f_quad"])
    every = (
        "every start"
        if refined == total
        else f"a start with f ≤ {number(settings['refine_below'], 1)}"
    )
    blocks: list[Block] = [
        Text(
            f"{total} starts, uniform in [−{settings['width']:g}, {settings['width']:g}], seed "
            f"{settings['seed']}; lmdif in double with xtol = ftol = 1e−18 and at most "
            f"{settings['maxfev']} evaluations, then, for {every}, in real(16) with "
            f"xtol = ftol = 1e−32 and at most {settings['refine_maxfev']}. {data['at_limit']} of "
            f"the starts ended at the limit of evaluations in double. f is the sum of squares "
            "over the independent conditions, as in the paper, whose table has zeros for the "
            "others; its square root is the norm that the drivers of lmdif print. A start is "
            "determined by the seed and its number alone."
        ),
        Chart(
            f"search{plan.order}",
            partial(_draw, data=data),
            f"Fraction of starts with at most this f, order {plan.order}, {plan.stages} stages. "
            "Dotted lines: the paper's values, taken as f.",
            f"{total} starts; the median of f after double is "
            f"{number(data['f_double_quartiles'][2], 2)}; {exact} starts ended in an exact method.",
            size=(8.0, 3.6),
        ),
        Table(
            "f after either phase",
            ("phase", "paper", "starts", "smallest", "lower quartile", "median", "upper quartile",
             "largest", "root of the smallest", "root of the median"),
            [
                _phase_row("double", "f_double", data, total),
                _phase_row("real(16)", "f_quad", data, refined),
            ],
        ),
        Text(_summary(data, exact, total)),
    ]  # fmt: skip
    for method in data["methods"]:
        inside = "in" if method["abscissae_in_unit_interval"] else "not all in"
        title = (
            f"{method['name']}: largest coefficient {number(method['largest_coefficient'])}, "
            f"abscissae {inside} [0, 1]"
        )
        blocks.append(coefficient_table(title, method))
    if not data["methods"]:
        best = data["best"]
        title = (
            f"Not exact: the start with the smallest residual, f = {number(best['f'], 2)}, "
            f"largest residual {number(best['max_residual'], 2)}"
        )
        blocks.append(coefficient_table(title, best))
    return blocks


def _phase_row(title: str, key: str, data: Data, starts: int) -> list[str]:
    five = data[f"{key}_quartiles"] or [None] * 5
    roots = [None if value is None else math.sqrt(value) for value in (five[0], five[2])]
    values = (number(value, 2) for value in (*five, *roots))
    return [title, number(data["paper"][key], 1), number(starts), *values]


def _summary(data: Data, exact: int, total: int) -> str:
    if not exact:
        return f"None of {total} starts ended in an exact method."
    return (
        f"{exact} of {total} starts ended in an exact method (all residuals at the rounding of "
        f"real(16)), {data['distinct']} of them distinct, {data['abscissae_in_unit_interval']} "
        f"with all abscissae in [0, 1]. Those with the smallest coefficients follow, to 16 "
        "decimals; results.json has all 36 digits."
    )


def _draw(figure: Figure, data: Data) -> None:
    axes = figure.subplots()
    phases = (
        ("after double", data["f_double"], data["paper"]["f_double"], "vermilion", "o", "--"),
        ("after real(16)", data["f_quad"], data["paper"]["f_quad"], "blue", "s", "-"),
    )
    for label, values, paper, colour, marker, line in phases:
        sizes = np.sort([max(f, _MIN_F) for f in values if f is not None])
        if sizes.size:
            fraction = np.arange(1, sizes.size + 1) / sizes.size
            axes.step(
                sizes, fraction, where="post", color=PALETTE[colour], linestyle=line, marker=marker,
                markersize=3.5, markevery=max(1, sizes.size // 25),
                label=f"{label}, {sizes.size} starts",
            )  # fmt: skip
        axes.axvline(
            paper, color=PALETTE[colour], linestyle=":", linewidth=1.5,
            label=f"paper, {label}: {number(paper, 1)}",
        )  # fmt: skip
    grid(axes, x=True, y=False)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("f = sum of squared residuals")
    axes.set_ylabel("fraction of starts")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)


ITEMS = tuple(
    Item(
        f"search{order}",
        f"Search: order {order}, {plan.stages} stages",
        60 + order,
        30 + order,
        partial(compute, plan),
        partial(present, plan),
    )
    for order, plan in PLANS.items()
)
