"""Errors of pairs compared with the tolerance, and work at equal errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

import numpy as np

import cg
from cg.catalogue import munthe_kaas, resolve_method
from cg.formats.markdown import replace_between, table
from cg.frames import SO3

from .cases import Case, cases
from .record import Aim, Result, Row
from .solvers import pairs
from .work_curves import QUANTITIES, Curve, Point, run_point

BEGIN, END = "<!-- estimates -->\n", "<!-- end of estimates -->\n"
"""Marks before and after the table of all pairs in docs/catalogue.md."""

MEDIAN, LARGEST = 5.0, 50.0
"""Bounds on error / tolerance of a default of `cg.solve_ivp`: on the median and the maximum."""

_TOLERANCES = tuple(10.0**-k for k in range(1, 11))
_MAX_TOLERANCE = 1e-3  # larger tolerances are used for work at large errors only
_SPINS = 50
_SEED = 1
_SLOWEST = 5.0  # seconds, after which smaller tolerances are left out
_ERRORS = (1e-3, 1e-5, 1e-8)
_AGAINST = "RKMK8(5,3)"

_DECISIVE = (1e-3, 1e-8)  # at loose and at tight tolerances
_NO_BRACKETS = "without brackets"
_COSTS = {
    "compiled": ("time",),
    "in Python, with brackets": ("flows",),
    _NO_BRACKETS: ("evaluations", "flows"),
}
_ALIKE = 1.1  # costs up to this multiple of the least count as equal

TITLE = "Error estimates"
DETAILS = "Errors at the end divided by the tolerance, and work at equal errors, of all pairs."

Runs = dict[str, dict[float, Point]]
"""Runs by pair and tolerance."""

Curves = Sequence[Mapping[str, Curve]]
"""Curves by equation and pair."""


def method_text(smallest: float, count: int) -> str:
    """Return how errors are compared with tolerances."""
    return (
        "The largest error of an entry at the end, divided by the tolerance (`rtol = atol` from "
        f"{_MAX_TOLERANCE:g} to {smallest:g}), of all explicit pairs on the ten problems above and "
        f"on {count} spins: rotations with f = u + 0.3 times the first row of the rotation, |u| "
        f"from 5 to 30, t from 0 to 3. After a run longer than {_SLOWEST:g} s smaller tolerances "
        "are left out. [The catalogue](catalogue.md) has the table of all pairs. A default of "
        f"`cg.solve_ivp` must have a median of at most {MEDIAN:g} and a maximum of at most "
        f"{LARGEST:g}."
    )


def spins(count: int) -> list[Case]:
    """Return rotations that are dominated by a spin: 5 to 30 rad/s about any axis."""
    generator = np.random.default_rng(_SEED)
    rotations = []
    for k in range(count):
        axis = generator.standard_normal(3)
        velocity = generator.uniform(5.0, 30.0) * axis / np.linalg.norm(axis)
        rotations.append(_spin(f"spin_{k}", velocity.tolist()))
    return rotations


def _spin(name: str, velocity: list[float]) -> Case:
    u1, u2, u3 = velocity

    def f(t: float, y: np.ndarray) -> list[float]:
        a, b, c = y[0].tolist()
        return [u1 + 0.3 * a, u2 + 0.3 * b, u3 + 0.3 * c]

    frame, y0, end = SO3(), np.eye(3), 3.0
    exact = cg.integrate(f, (0.0, end), y0, frame=frame, method="RKMK8(5,3)", h=end / 2048).y[-1]
    return Case(name, name.replace("_", " "), frame, f, y0, end, exact)


def run(quick: bool, figures: Path | None) -> Result:
    """Run all pairs with all tolerances on the spins and on the ten problems."""
    tolerances = _TOLERANCES[:6] if quick else _TOLERANCES
    rounds = 1 if quick else 3
    spinning = [_runs(case, tolerances, 1) for case in spins(3 if quick else _SPINS)]
    problems = [_runs(case, tolerances, rounds) for case in cases(["heavy_top"] if quick else None)]
    names = list(problems[0])
    runs = spinning + problems
    tables = (
        _by_tolerance(names, spinning, problems), _work(problems, rounds), _work(spinning, 0)
    )  # fmt: skip
    rows = tuple(row for name in names for row in _rows(name, runs))
    return Result(
        TITLE, method_text(tolerances[-1], len(spinning)), (), (_defaults(runs, problems),),
        details=Result(TITLE, DETAILS, rows, tables),
    )  # fmt: skip


def _runs(case: Case, tolerances: tuple[float, ...], rounds: int) -> Runs:
    left = {pair.name: pair for pair in pairs(case, tolerances)}
    runs: Runs = {name: {} for name in left}
    for tolerance in tolerances:
        solve = {name: pair.solve for name, pair in left.items()}
        for name, point in run_point(case, solve, tolerance, rounds).items():
            runs[name][tolerance] = point
            if point.seconds > _SLOWEST:
                del left[name]
    return runs


def _quotients(name: str, runs: list[Runs]) -> list[float]:
    """Return errors divided by tolerances."""
    return [
        p.error / tolerance
        for by_pair in runs
        for tolerance, p in by_pair[name].items()
        if tolerance <= _MAX_TOLERANCE
    ]


def _rows(name: str, runs: list[Runs]) -> list[Row]:
    quotients = _quotients(name, runs)
    middle, most, largest = np.quantile(quotients, [0.5, 0.9, 1.0]).tolist()
    return [
        Row(f"`{name}`, median", middle, "tolerances", aim=Aim(MEDIAN, False, "value")),
        Row(f"`{name}`, 90 % below", most, "tolerances"),
        Row(f"`{name}`, largest", largest, "tolerances", aim=Aim(LARGEST, False, "value")),
    ]


def stored(result: Result) -> dict[str, dict[str, float]]:
    """Return the stored numbers of each pair: median, 90 % below, largest."""
    assert result.details is not None
    numbers: dict[str, dict[str, float]] = {}
    for row in result.details.rows:
        name, what = row.quantity.removeprefix("`").split("`, ")
        numbers.setdefault(name, {})[what] = row.value
    return numbers


def write_table(result: Result, page: Path) -> None:
    """Write the table of all pairs between the marks of a page."""
    rows = []
    for name, numbers in stored(result).items():
        honest = numbers["median"] <= MEDIAN and numbers["largest"] <= LARGEST
        cells = [f"{number:.2g}" for number in numbers.values()]
        rows.append([f"`{name}`", *cells, "yes" if honest else "**no**"])
    text = table(("pair", "median", "90 % below", "largest", "honest"), rows)
    replace_between(page, BEGIN, END, f"{text}\n")


def _by_tolerance(names: list[str], spinning: list[Runs], problems: list[Runs]) -> str:
    tolerances = [k for k in spinning[0][names[0]] if k <= _MAX_TOLERANCE]
    heads = [
        f"{kind}, {tolerance:g}" for kind in ("spins", "problems") for tolerance in tolerances[::2]
    ]
    rows = []
    for name in names:
        cells = []
        for runs in (spinning, problems):
            for tolerance in tolerances[::2]:
                here = [r[name][tolerance].error / tolerance for r in runs if tolerance in r[name]]
                cells.append(f"{median(here):.2g}, {max(here):.2g}" if here else "")
        rows.append([f"`{name}`", *cells])
    title = "**Error divided by tolerance**, median and largest, by tolerance:"
    return f"{title}\n\n{table(['', *heads], rows)}"


def _defaults(runs: list[Runs], problems: list[Runs]) -> str:
    """Return which pairs the rule of `cg.integration.default_method` chooses."""
    names = [name for name in problems[0] if _may_be_default(name, runs)]
    curves = _curves(problems)
    rows = []
    for frames, kinds in _COSTS.items():
        fit = [n for n in names if n not in munthe_kaas or frames != _NO_BRACKETS]
        cells = [_cheapest(fit, curves, error, kinds) for error in _DECISIVE]
        rows.append([frames, " + ".join(kinds), *cells])
    header = ["frames", "cost", *(f"for errors of {error:g}" for error in _DECISIVE)]
    return (
        "The [rule for the default](howto/choose.md#the-rule-for-the-default) chooses among "
        f"{', '.join(f'`{name}`' for name in names)}:\n\n{table(header, rows)}"
    )


def _may_be_default(name: str, runs: list[Runs]) -> bool:
    """Return whether the errors are near the tolerance, and all stages within the step."""
    quotients = _quotients(name, runs)
    within = all(0.0 <= c <= 1.0 for c in resolve_method(name).c.tolist())
    return within and median(quotients) <= MEDIAN and max(quotients) <= LARGEST


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
    return [
        {name: Curve.of(name, "pair", 0, list(points.values())) for name, points in r.items()}
        for r in runs
    ]


def _work(runs: list[Runs], rounds: int) -> str:
    """Return a table of work at equal errors, divided by that of one pair."""
    kinds = [kind for kind in QUANTITIES if rounds or kind != "time"]
    heads = [f"{kind}, {error:g}" for error in _ERRORS for kind in kinds]
    how = f"; times are medians of {rounds} rounds of all in turn" if rounds else ""
    rows = []
    curves = _curves(runs)
    for name in curves[0]:
        ratios = [_ratio(name, curves, error, kind) for error in _ERRORS for kind in kinds]
        rows.append([f"`{name}`", *("" if math.isnan(r) else f"{r:.2f}" for r in ratios)])
    return (
        f"**Work at equal errors** divided by that of `{_AGAINST}`, on the "
        f"{'problems' if rounds else 'spins'}, medians{how}:\n\n{table(['', *heads], rows)}"
    )


def _ratio(name: str, curves: Curves, error: float, kind: str) -> float:
    """Return the median quotient of the work and that of the reference pair, or NaN."""
    ratios = [c[name].at(error, kind) / c[_AGAINST].at(error, kind) for c in curves]
    ratios = [ratio for ratio in ratios if not math.isnan(ratio)]
    return median(ratios) if ratios else math.nan
