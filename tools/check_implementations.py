"""Diagnose tableaux of other implementations: ``python tools/check_implementations.py``.

Reads docs/implementations.toml, and writes the table of docs/implementations.md.
"""

import sys
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cg.analysis.convergence import final_errors, observed_order
from cg.analysis.diagnosis import Diagnosis
from cg.analysis.diagnosis.diagnosis import diagnose_entry
from cg.method.method import Method
from cg.method.tableau import Tableau
from cg.problems import StateDependentRotation
from cg.reproduce import markdown

DOCS = Path(__file__).parent.parent / "docs"
DATA, PAGE = DOCS / "implementations.toml", DOCS / "implementations.md"
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
    return observed_order(steps, errors, floor=_FLOOR)


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


def main() -> int:
    """Write the page."""
    text = table([check(entry) for entry in read()])
    markdown.replace_between(PAGE, "<!-- table -->\n", "<!-- end of table -->\n", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
