"""Errors of pairs compared with the tolerance on random families, and work at equal errors."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

import numpy as np

import cg
from cg.construction.catalogue import resolve_method
from cg.construction.catalogue.summary import summary_of
from cg.construction.methods.estimate import MAX_RATIO, estimate_ratio, result_and_estimate
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.paths import paths_of
from reproduce.markdown import replace_between, table

from .cases import Case, cases
from .families import Array, Family, families
from .record import Result
from .solvers import pairs
from .work_curves import Curve, Point, run_point

BEGIN, END = "<!-- estimates -->\n", "<!-- end of estimates -->\n"
"""Marks before and after the table of all pairs in docs/catalogue.md."""

MAX_MEDIAN, MAX_QUOTIENT = 5.0, 50.0
"""Bounds on error / tolerance of a default of `cg.solve_ivp`: on the median and the maximum."""

TOLERANCES = tuple(10.0**-k for k in range(3, 11))
"""Those at which errors are compared with them."""

_MEMBERS = 100
_WORK_TOLERANCES = tuple(10.0**-k for k in range(1, 11))
_SLOWEST = 5.0  # seconds, after which smaller tolerances are left out
_AGAINST = "RKMK8(5,3)"

_DECISIVE = (1e-3, 1e-8)  # at loose and at tight tolerances
_NO_BRACKETS = "without brackets"
_COSTS = {
    "compiled": ("time",),
    "in Python, with brackets": ("flows",),
    _NO_BRACKETS: ("evaluations", "flows"),
}
RATIO = "error / estimate"
_QUANTILES = ("median", "90 % below", "largest")
_BLIND = 1e6  # largest ratio of a pair that sees all jumps
_ROUNDING = 1e-12  # distance of nodes that count as equal
_ALIKE = 1.1  # costs up to this multiple of the least count as equal

TITLE = "Error estimates"

Quotients = dict[str, dict[str, list[Array]]]
"""Errors divided by tolerances, by pair and name of the family."""

Runs = dict[str, dict[float, Point]]
"""Runs by pair and tolerance."""

Curves = Sequence[Mapping[str, Curve]]
"""Curves by equation and pair."""


def method_text(count: int) -> str:
    """Return how errors are compared with tolerances."""
    return (
        "The error at the end in tolerances (`rtol = atol`, root mean square over coordinates, "
        f"from {TOLERANCES[0]:g} to {TOLERANCES[-1]:g}) of all explicit pairs on random families "
        f"of {count} problems each: nearly free bodies, a dominant spin, a slow drift, fields that "
        "depend weakly and strongly on the point; on SO(3), unit quaternions, SE(3), SU(2), SU(3), "
        f"the sphere and vectors. After runs longer than {_SLOWEST:g} s smaller tolerances are "
        "left out. Work at equal errors is that on the ten problems above. "
        "[The catalogue](catalogue.md) has the table of all pairs. A default of `cg.solve_ivp` "
        f"must have a median of at most {MAX_MEDIAN:g} and a maximum of at most {MAX_QUOTIENT:g}."
    )


def run(quick: bool) -> Result:
    """Run all pairs on the families, and on the ten problems."""
    members, rounds = (3, 1) if quick else (_MEMBERS, 3)
    tolerances = _WORK_TOLERANCES[:6] if quick else _WORK_TOLERANCES
    problems = [_runs(case, tolerances, rounds) for case in cases(["heavy_top"] if quick else None)]
    names = list(problems[0])
    quotients = measure(names, members, TOLERANCES[:3] if quick else TOLERANCES)
    numbers = {name: _numbers(name, quotients) for name in names}
    return Result(TITLE, method_text(members), (), (_defaults(quotients, problems),), numbers)


def measure(names: Sequence[str], members: int, tolerances: Sequence[float]) -> Quotients:
    """Return errors divided by tolerances of pairs on all families."""
    quotients: Quotients = {name: {} for name in names}
    for family in families(members):
        exact = family.reference()
        for name in names:
            parts = quotients[name].setdefault(family.name, [])
            parts += _quotients(family, exact, name, tolerances)
    return quotients


def _quotients(family: Family, exact: Array, name: str, tolerances: Sequence[float]) -> list[Array]:
    """Return the quotients of a family, up to the tolerance that takes long."""
    parts = []
    for tolerance in tolerances:
        begin = time.perf_counter()
        parts.append(family.errors(family.solve(name, tolerance), exact) / tolerance)
        if time.perf_counter() - begin > _SLOWEST:
            break
    return parts


def _all(name: str, quotients: Quotients) -> Array:
    return np.concatenate([part for parts in quotients[name].values() for part in parts])


def _numbers(name: str, quotients: Quotients) -> dict[str, float]:
    """Return error / estimate of a pair, and quantiles of its quotients."""
    ratio = summary_of(resolve_method(name)).estimate_ratio
    assert ratio is not None
    quantiles = np.quantile(_all(name, quotients), [0.5, 0.9, 1.0]).tolist()
    return {RATIO: ratio, **dict(zip(_QUANTILES, quantiles, strict=True))}


def _runs(case: Case, tolerances: tuple[float, ...], rounds: int) -> Runs:
    left = pairs(case)
    runs: Runs = {name: {} for name in left}
    for tolerance in tolerances:
        for name, point in run_point(case, left, tolerance, rounds).items():
            runs[name][tolerance] = point
            if point.seconds > _SLOWEST:
                del left[name]
    return runs


def write_table(result: Result, page: Path) -> None:
    """Write the table of all pairs between the marks of a page.

    The ratios are computed anew. Magnus methods, for equations without the point, and implicit
    pairs have no errors on the families.
    """
    rows = []
    for name, method in cg.methods.items():
        ratio = estimate_ratio(method)
        if ratio is None:
            continue
        numbers = result.numbers.get(name, {})
        reliable = ""
        if numbers:
            fits = ratio <= MAX_RATIO and numbers["median"] <= MAX_MEDIAN
            reliable = "yes" if fits and numbers["largest"] <= MAX_QUOTIENT else "**no**"
        errors = [f"{numbers[key]:.2g}" if key in numbers else "" for key in _QUANTILES]
        jumps = break_ratio(method, 0)
        seen = "" if jumps is None else f"{jumps:.2g}" if jumps < _BLIND else "not seen"
        rows.append([f"`{name}`", f"{ratio:.2g}", seen, *errors, reliable])
    rows.sort(key=lambda row: row[0] not in {f"`{name}`" for name in result.numbers})
    head = ("pair", RATIO, "at a jump", *_QUANTILES, "reliable")
    replace_between(page, BEGIN, END, f"{table(head, rows)}\n")


def break_ratio(method: Method, power: int) -> float | None:
    """Return the largest ratio of the error of a step to its estimate where the field breaks.

    The field jumps, or its derivative of order `power` does. The ratio of jumps is infinite for a
    pair that has no node at the end of the step. None without an error estimate, and for Magnus
    methods, whose estimates also use the nodes of the step before.
    """
    if method.embedded_order is None or isinstance(method, MagnusMethod):
        return None
    c, ratios = paths_of(method).abscissae, []
    for jump in ((np.arange(1000) + 0.5) / 1000).tolist():
        values = np.where(c >= jump, (c - jump) ** power, 0.0)
        (result,), (estimate,) = result_and_estimate(method, values, np.zeros(1))
        exact = (1 - jump) ** (power + 1) / (power + 1)
        ratios.append(abs(result - exact) / max(estimate, 1e-300))
    return float(max(ratios))


def _defaults(quotients: Quotients, problems: list[Runs]) -> str:
    """Return which pairs the rule of `cg.integration.default_method` chooses."""
    names = [name for name in problems[0] if _may_be_default(name, quotients)]
    curves = _curves(problems)
    rows = []
    for frames, kinds in _COSTS.items():
        fit = [
            n
            for n in names
            if not isinstance(resolve_method(n), cg.MuntheKaas) or frames != _NO_BRACKETS
        ]
        cells = [_cheapest(fit, curves, error, kinds) for error in _DECISIVE]
        rows.append([frames, " + ".join(kinds), *cells])
    header = ["frames", "cost", *(f"for errors of {error:g}" for error in _DECISIVE)]
    return (
        "The [rule for the default](howto/choose.md#the-rule-for-the-default) chooses among "
        f"{', '.join(f'`{name}`' for name in names)}:\n\n{table(header, rows)}"
    )


def _may_be_default(name: str, quotients: Quotients) -> bool:
    """Return whether estimates are reliable and see jumps, and all stages are within the step."""
    method, errors = resolve_method(name), _all(name, quotients)
    ratio, jumps = summary_of(method).estimate_ratio, break_ratio(method, 0)
    assert ratio is not None
    assert jumps is not None
    reliable = (
        ratio <= MAX_RATIO and np.median(errors) <= MAX_MEDIAN and errors.max() <= MAX_QUOTIENT
    )
    within = all(0.0 <= c <= 1.0 + _ROUNDING for c in method.c.tolist())
    return bool(reliable and within and jumps <= MAX_QUOTIENT)


def _cheapest(names: list[str], curves: Curves, error: float, kinds: tuple[str, ...]) -> str:
    """Return the pair with the smallest counts among those of about least cost, or ""."""
    costs = {name: sum(_ratio(name, curves, error, kind) for kind in kinds) for name in names}
    least = min((cost for cost in costs.values() if not math.isnan(cost)), default=math.nan)
    alike = [name for name, cost in costs.items() if cost <= _ALIKE * least]
    cheapest = min(alike, key=lambda name: _counts(name, curves, error), default="")
    return f"`{cheapest}`" if cheapest else ""


def _counts(name: str, curves: Curves, error: float) -> float:
    return sum(_ratio(name, curves, error, kind) for kind in ("evaluations", "flows"))


def _curves(runs: list[Runs]) -> Curves:
    return [{name: Curve.of(list(points.values())) for name, points in r.items()} for r in runs]


def _ratio(name: str, curves: Curves, error: float, kind: str) -> float:
    """Return the median quotient of the work and that of the reference pair, or NaN."""
    ratios = [c[name].at(error, kind) / c[_AGAINST].at(error, kind) for c in curves]
    ratios = [ratio for ratio in ratios if not math.isnan(ratio)]
    return median(ratios) if ratios else math.nan
