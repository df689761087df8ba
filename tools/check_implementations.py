"""Diagnose tableaux of other implementations: ``python tools/check_implementations.py``.

Reads docs/implementations.toml and the slopes stored in benchmarks/, and writes the tables of
docs/implementations.md.
"""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cg.analysis.convergence import final_errors, observed_order
from cg.analysis.diagnosis import Diagnosis
from cg.analysis.diagnosis.files import diagnose_entry
from cg.formats import markdown
from cg.method.method import Method
from cg.method.tableau import Tableau
from cg.problems import StateDependentRotation

DOCS = Path(__file__).parent.parent / "docs"
DATA, PAGE = DOCS / "implementations.toml", DOCS / "implementations.md"
MEASURED = DOCS.parent / "benchmarks"
_FLOOR = 2e-13  # of errors: rounding over all steps
_STEPS = (16, 24, 32, 48, 64)


@dataclass(frozen=True)
class Checked:
    """A tableau of an implementation, its diagnosis and its observed order."""

    entry: dict[str, Any]
    diagnosis: Diagnosis
    slope: float

    @property
    def row(self) -> tuple[str, ...]:
        """Cells of the table."""
        says, order = _pair(self.entry["says"], self.entry.get("says_embedded")), self.diagnosis
        return (
            self.entry["implementation"],
            f"`{self.entry['name']}`",
            says,
            _pair(order.order, order.embedded_order),
            str(order.flat_order),
            f"{self.slope:.1f}",
            self.verdict,
        )

    @property
    def verdict(self) -> str:
        """Recognised mistakes, and the largest residual up to the claimed order."""
        findings = "; ".join(finding.message for finding in self.diagnosis.findings)
        note = self.entry.get("note", "")
        residual = self.diagnosis.method.largest_residual(self.entry["says"])
        size = f"conditions to {residual:.0e}" if residual else "conditions exactly"
        right = self.diagnosis.order >= self.entry["says"]
        return "; ".join(part for part in (findings, note, size if right or residual < 1e-9 else
                         f"conditions off by {residual:.1g}") if part)  # fmt: skip


def read() -> list[dict[str, Any]]:
    """Return the entries of the data file."""
    entries: list[dict[str, Any]] = tomllib.loads(DATA.read_text(encoding="utf-8"))["method"]
    return entries


def check(entry: dict[str, Any]) -> Checked:
    """Diagnose an entry and measure its order."""
    keys = ("a", "b", "b_embedded", "c")
    diagnosis = diagnose_entry({key: entry[key] for key in keys if key in entry})
    # without second weights, since `integrate` advances with the weights of higher order
    return Checked(entry, diagnosis, slope_of(Tableau(entry["a"], entry["b"])))


def slope_of(method: Method) -> float:
    """Return the observed order on a problem that depends on all order conditions."""
    problem = StateDependentRotation()
    steps = [1 / n for n in _STEPS]
    errors = final_errors(
        problem.f, (0, 1), problem.y0, _end(), frame=problem.frame, method=method, h=steps
    )
    return observed_order(steps, errors, floor=_FLOOR).order


@cache
def _end() -> Any:
    solution = StateDependentRotation().reference([0, 1]).values[-1]
    return np.array([float(x) for x in solution[:9]]).reshape(3, 3)


def _pair(first: int, second: int | None) -> str:
    return str(first) if second is None else f"{first}({second})"


def table(checked: list[Checked]) -> str:
    """Return the table of the page."""
    heads = ("implementation", "method", "says order", "order", "where flows commute", "slope",
             "what it is")  # fmt: skip
    sources = [f"- {i}: {w}" for i, w in {c.entry["implementation"]: c.entry["where"] for c in
               checked}.items()]  # fmt: skip
    shown = markdown.table(heads, [c.row for c in checked])
    return "\n".join([shown, "", "Sources:", "", *sources]) + "\n"


def linear_table() -> str:
    """Return the table of slopes on the test problems of OrdinaryDiffEq.jl."""
    slopes = json.loads((MEASURED / "linear_test.json").read_text(encoding="utf-8"))
    rows = []
    for name, row in slopes.items():
        keys = ("sin(t)", "sin(u)", "rotation")
        rows.append([name, *(f"{row[key]:.1f}" if key in row else "–" for key in keys)])
    return markdown.table(("stages", "s = sin t", "s = sin u₁", "rotation"), rows) + "\n"


def rotation_table() -> str:
    """Return the table of orders at which simulators move a rotation."""
    rows = json.loads((MEASURED / "rotation_order.json").read_text(encoding="utf-8"))
    merged: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows:
        key = (row["package"], row["integrator"], f"{row['slope']:.1f}")
        merged.setdefault(key, []).append(row)
    rows_of_table = []
    ranked = sorted(merged.items(), key=lambda item: (item[0][0], -float(item[0][2])))
    for (package, integrator, slope), equal in ranked:
        versions = ", ".join(row["version"] for row in sorted(equal, key=_release))
        error = max(row["errors"][-1] for row in equal)
        rows_of_table.append((package, versions, integrator, slope, f"{error:.0e}"))
    heads = ("package", "version", "integrator", "observed order", "error with 800 steps")
    return markdown.table(heads, rows_of_table) + "\n"


def _release(row: dict[str, Any]) -> list[int]:
    return [int(part) for part in row["version"].split(".") if part.isdigit()]


def replace(name: str, text: str) -> None:
    """Write the page with the text between two comments replaced."""
    markdown.replace_between(PAGE, f"<!-- {name} -->\n", f"<!-- end of {name} -->\n", text)


def main() -> int:
    """Write the page."""
    replace("table", table([check(entry) for entry in read()]))
    replace("slopes", linear_table())
    replace("rotations", rotation_table())
    return 0


if __name__ == "__main__":
    sys.exit(main())
