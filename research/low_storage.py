"""Write the tables of docs/low_storage.md anew: ``python research/low_storage.py [FILE]``.

Methods in print satisfy their conditions to their digits only. Each is moved to the closest
solution of the classical conditions alone, by corrections of least norm in A and B whose
residuals are exact; the conditions on manifolds are evaluated there. The second table has pairs on
a gradient flow on SU(3).
"""

import sys
import tomllib
from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cg
from cg.construction.conditions import residuals
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.flat import flat_residuals
from cg.construction.methods.low_storage import from_two_registers
from cg.construction.solvers.polish import refine_rational
from cg.construction.solvers.singular import pseudo_inverse
from cg.reproduce.markdown import replace_between, table

METHODS = Path(__file__).parent / "two_register_methods.toml"
BEGIN, END = "<!-- table -->\n", "<!-- end of table -->\n"
PAIRS, END_OF_PAIRS = "<!-- pairs -->\n", "<!-- end of pairs -->\n"
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

    inverse, _ = pseudo_inverse(slopes(parameters, order), RANK_CUT)
    end = refine_rational(residuals, parameters, inverse, below=ENOUGH, grid=GRID)
    if end.largest_residual > ENOUGH:
        raise RuntimeError(f"residuals are still {float(end.largest_residual):.1e}")
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


def table_of_pairs() -> str:
    """Return the table of pairs: numbers stored, evaluations and errors on SU(3).

    With random S, ``y' = -P(y S) y``, P the part in the algebra: the flow of the action Re tr(y S).
    """
    frame, rng = cg.frames.SU(3), np.random.default_rng(1)
    s = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    start = frame.random_point(rng)

    def f(_: float, y: NDArray[np.complex128]) -> NDArray[np.float64]:
        m = y @ s
        m = (m.conj().T - m) / 2
        return frame.coefficients(y, (m - np.trace(m) / 3 * np.eye(3)) @ y)

    def solve(method: str, tolerance: float) -> Any:
        options = {"frame": frame, "method": method, "rtol": tolerance, "atol": tolerance}
        return cg.solve_ivp(f, (0.0, 3.0), start, **options)

    end = solve("CF7(6)", 1e-13).y[-1]
    cells = []
    for name, (points, fields) in STORED.items():
        runs = [solve(name, tolerance) for tolerance in TOLERANCES]
        errors = [f"{np.abs(run.y[-1] - end).max():.1e}" for run in runs]
        counts = [f"{run.nfev}: {error}" for run, error in zip(runs, errors, strict=True)]
        cells.append([f"`{name}`", str(18 * points + 8 * fields), *counts])
    header = "pair", "numbers a link", *(f"tolerance {one:.0e}" for one in TOLERANCES)
    return table(header, cells) + "\n"


def main(path: str = "docs/low_storage.md") -> None:
    """Replace the tables of the page."""
    rows = [row_of(entry) for entry in entries()]
    replace_between(Path(path), BEGIN, END, table_of(rows))
    replace_between(Path(path), PAIRS, END_OF_PAIRS, table_of_pairs())


if __name__ == "__main__":
    main(*sys.argv[1:])
