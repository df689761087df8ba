"""Write the tables on methods of two registers anew: ``python research/low_storage.py [FOLDER]``.

Those of docs/low_storage.md have pairs and equal steps on the gradient flow of a lattice, that of
docs/mathematics/two_registers.md methods in print. These satisfy their conditions to their digits
only. Each is moved to the closest solution of the classical conditions alone, by corrections of
least norm in A and B whose residuals are exact; the conditions on manifolds are evaluated there.
"""

import runpy
import sys
import tomllib
import warnings
from collections.abc import Sequence
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cg
from cg.construction.conditions import residuals
from cg.construction.methods.classical_conditions import flat_residuals
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.low_storage import from_two_registers
from cg.construction.solvers.minimum_norm import decompose
from cg.construction.solvers.refine import refine_rational
from cg.reproduce.markdown import replace_between, table

METHODS = Path(__file__).parent / "two_register_methods.toml"
BEGIN, END = "<!-- table -->\n", "<!-- end of table -->\n"
PAIRS, END_OF_PAIRS = "<!-- pairs -->\n", "<!-- end of pairs -->\n"
STEPS, END_OF_STEPS = "<!-- steps -->\n", "<!-- end of steps -->\n"
EQUAL = "Lüscher", "Berland–Bogey–Bailly", "CF4b", "CF4(3)r", "CF4r", "CF5r"
EVALUATIONS = 48, 96, 192, 384
EXAMPLE, SIDES, TIME = Path("docs/gallery/gradient_flow.py"), (4, 4, 4, 4), 1.0
STORED = {
    "BS3(2)": (3, 4),
    "CF3(2)r": (3, 2),
    "CF4(3)": (3, 5),
    "CF4(3)r": (3, 2),
    "CF5(4)": (3, 7),
}
"""Points and coefficients that a step of a pair stores at once, its start included."""
TOLERANCES = 1e-3, 1e-5, 1e-7
GRID = 10**75  # parameters are multiples of 1/GRID, so that they don't grow
STEP = Fraction(1, 10**30)  # step of differences
ENOUGH = Fraction(1, 10**60)
RANK_CUT = 1e-7  # singular values below this fraction of the largest count as zero
ZERO = Fraction(1, 10**55)  # what is below counts as zero where residuals are exact

Numbers = Sequence[Fraction]
exactly = partial(residuals, arithmetic="exact")


class Row(NamedTuple):
    """Properties of a method."""

    name: str
    source: str
    stages: int
    flat_order: int  # the classical order that is claimed
    flat: Fraction  # the largest classical residual, through it, of the printed numbers
    on_manifolds: Fraction  # likewise in those on manifolds
    beyond: Fraction  # the largest one of the classical conditions of the next order
    moved: Fraction  # how far A and B are from the closest solution of the classical conditions
    order: int  # the order on manifolds there: all residuals are below `ZERO`
    flat_refined: Fraction  # the residual there, through the classical order
    refined: Fraction  # likewise on manifolds


def entries() -> list[dict[str, Any]]:
    """Return the methods as they are in print."""
    methods: list[dict[str, Any]] = tomllib.loads(METHODS.read_text(encoding="utf-8"))["method"]
    return methods


def weights_of(parameters: Numbers) -> CommutatorFree:
    """Return the method with A_2 … A_s, B_1 … B_s, all exact."""
    stages = (len(parameters) + 1) // 2
    return from_two_registers([Fraction(0), *parameters[: stages - 1]], parameters[stages - 1 :])


def slopes(parameters: Numbers, order: int) -> NDArray[np.float64]:
    """Return the derivatives of the classical residuals, by exact differences."""
    here = flat_residuals(*weights_of(parameters).exact, order)
    columns = []
    for k in range(len(parameters)):
        moved = [p + STEP * (j == k) for j, p in enumerate(parameters)]
        pairs = zip(flat_residuals(*weights_of(moved).exact, order), here, strict=True)
        columns.append([float((there - value) / STEP) for there, value in pairs])
    return np.array(columns).T


def closest(parameters: Numbers, order: int) -> list[Fraction]:
    """Return parameters close to given ones that satisfy the classical conditions alone."""

    def residuals(parameters: Numbers) -> Numbers:
        return flat_residuals(*weights_of(parameters).exact, order)

    inverse, _ = decompose(slopes(parameters, order), RANK_CUT)
    end = refine_rational(residuals, parameters, inverse, below=ENOUGH, grid=GRID)
    if end.max_residual > ENOUGH:
        raise RuntimeError(f"residuals are still {float(end.max_residual):.1e}")
    return list(end.x)


def _largest(residuals: Sequence[Fraction]) -> Fraction:
    return max(map(abs, residuals))


def row_of(entry: dict[str, Any]) -> Row:
    """Return the properties of one method."""
    parameters = [Fraction(text) for text in (*entry["a"], *entry["b"])]
    printed, order = weights_of(parameters), entry["order"]
    exact = closest(parameters, order)
    refined = weights_of(exact)
    orders = range(1, order + 2)
    order_on_manifolds = next(
        (q - 1 for q in orders if _largest(exactly(refined, q)) > ZERO), order + 1
    )
    return Row(
        entry["name"],
        entry["source"],
        len(entry["b"]),
        order,
        _largest(flat_residuals(*printed.exact, order)),
        _largest(exactly(printed, order)),
        _largest(flat_residuals(*printed.exact, order + 1)),
        max(abs(x - y) for x, y in zip(exact, parameters, strict=True)),
        order_on_manifolds,
        _largest(flat_residuals(*refined.exact, order)),
        _largest(exactly(refined, order)),
    )


def _power(number: Fraction) -> str:
    """Return a number with one digit and its power of ten."""
    if number == 0:
        return "0"
    digit, _, power = f"{float(number):.0e}".partition("e")
    return f"{digit}e{int(power)}".replace("-", "−")


def _bound(number: Fraction) -> str:
    """Return a residual after corrections, whose last digits depend on the machine."""
    return "0" if number == 0 else "< 1e−55" if number < Fraction(1, 10**55) else _power(number)


def table_of(rows: Sequence[Row]) -> str:
    """Return the table as it stands in the page."""
    header = (
        "method", "stages", "flat order", "residual in print: flat", "on manifolds", "moved by",
        "residual there: flat", "on manifolds", "order on manifolds", "source",
    )  # fmt: skip
    cells = []
    for row in rows:
        numbers = map(_power, (row.flat, row.on_manifolds, row.moved))
        refined = map(_bound, (row.flat_refined, row.refined))
        cells_of_row = (
            row.name,
            row.stages,
            row.flat_order,
            *numbers,
            *refined,
            row.order,
            row.source,
        )
        cells.append([str(cell) for cell in cells_of_row])
    return table(header, cells) + "\n"


@cache
def gradient_flow() -> tuple[Any, NDArray[np.complex128]]:
    """Return the flow of the example on a lattice of four dimensions, and its end."""
    field: Any = runpy.run_path(str(EXAMPLE), run_name="gradient_flow")["GradientFlow"](SIDES)
    options = {"frame": field.frame, "method": "CF7(6)", "rtol": 1e-12, "atol": 1e-12}
    return field, cg.solve_ivp(field.f, (0.0, TIME), field.y0, **options).y[-1]


def table_of_steps() -> str:
    """Return the table of equal steps: errors of the action and of links by evaluations."""
    field, end = gradient_flow()
    printed = {e["name"]: weights_of(list(map(Fraction, (*e["a"], *e["b"])))) for e in entries()}
    cells = []
    for name in EQUAL:
        method = printed[name] if name in printed else cg.methods[name]
        row = [f"`{name}`" if name in cg.methods else name, str(method.stages)]
        for evaluations in EVALUATIONS:
            options = {"h": TIME / (evaluations // method.stages), "frame": field.frame}
            with warnings.catch_warnings(action="ignore"):  # orders of printed digits
                y = cg.integrate(field.f, (0.0, TIME), field.y0, method=method, **options).y[-1]
            error = abs(field.action(y) - field.action(end))
            row.append(f"{error:.1e}, {np.abs(y - end).max():.1e}")
        cells.append(row)
    return table(("method", "stages", *(f"{n} evaluations" for n in EVALUATIONS)), cells) + "\n"


def table_of_pairs() -> str:
    """Return the table of pairs: numbers stored, evaluations and errors of links."""
    field, end = gradient_flow()
    cells = []
    for name, (points, fields) in STORED.items():
        cells.append([f"`{name}`", str(18 * points + 8 * fields)])
        for tolerance in TOLERANCES:
            options = {"frame": field.frame, "method": name, "rtol": tolerance, "atol": tolerance}
            run = cg.solve_ivp(field.f, (0.0, TIME), field.y0, **options)
            cells[-1].append(f"{run.nfev}: {np.abs(run.y[-1] - end).max():.1e}")
    header = "pair", "numbers a link", *(f"tolerance {one:.0e}" for one in TOLERANCES)
    return table(header, cells) + "\n"


def main(folder: str = "docs") -> None:
    """Replace the tables of the pages in a folder."""
    proof, page = Path(folder, "mathematics/two_registers.md"), Path(folder, "low_storage.md")
    replace_between(proof, BEGIN, END, table_of([row_of(entry) for entry in entries()]))
    replace_between(page, PAIRS, END_OF_PAIRS, table_of_pairs())
    replace_between(page, STEPS, END_OF_STEPS, table_of_steps())


if __name__ == "__main__":
    main(*sys.argv[1:])
