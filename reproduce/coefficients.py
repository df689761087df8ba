"""Coefficients of methods as data and tables, and those printed in appendix A of the paper."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Context as DecimalContext
from decimal import Decimal
from fractions import Fraction
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.optimize import linprog

from cg import conditions
from cg.construction.catalogue import methods
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.construction.methods.tolerance import to_floats
from cg.support.arrays import Array
from cg.support.quads import to_decimal

from .blocks import Data, Table

RANK_THRESHOLD = 1e-12
"""Singular values below this, relative to the largest, count as zero."""

_COLUMNS = 3
_WIDE = DecimalContext(prec=80)


def labels(stages: int) -> list[str]:
    """Return the names of an explicit method's coefficients: a row by row, b, c."""
    comma = "," if stages > 9 else ""
    a = [f"a{i}{comma}{j}" for i in range(2, stages + 1) for j in range(1, i)]
    return [*a, *(f"{letter}{i}" for letter in "bc" for i in range(1, stages + 1))]


def fixed(text: str, places: int) -> str:
    """Round a decimal number, as `to_decimal` writes it, to a number of places, ties to even."""
    rounded = Decimal(text).quantize(Decimal(1).scaleb(-places), context=_WIDE)
    return f"{rounded:f}".replace("-", "−")


def method_data(method: Tableau, order: int) -> dict[str, Any]:
    """Return an explicit method as plain data.

    The keys are ``name``; ``coefficients``, a list of pairs of label and decimal with 36 digits;
    ``largest_coefficient`` of a and b; ``abscissae_in_unit_interval``; ``condition_number`` of the
    Jacobian of the independent conditions of an order, null where its rank is deficient.
    """
    texts = map(to_decimal, _values(method))
    return {
        "name": method.name,
        "coefficients": list(map(list, zip(labels(method.stages), texts, strict=True))),
        "largest_coefficient": largest_coefficient(method),
        "abscissae_in_unit_interval": all(0 <= entry <= 1 for entry in method.abscissae),
        "condition_number": condition_number(method, order),
    }


def _values(method: Method) -> list[Fraction]:
    """Return the exact values of an explicit method in the order of `labels`."""
    a, b = method.exact
    return [*(entry for i, row in enumerate(a) for entry in row[:i]), *b, *method.abscissae]


def condition_number(method: Method, order: int) -> float | None:
    """Return that of the Jacobian of the independent conditions; None if it has not full rank."""
    singular = singular_values(method, order)
    if singular[-1] <= RANK_THRESHOLD * singular[0]:
        return None
    return float(singular[0] / singular[-1])


def singular_values(method: Method, order: int) -> Array:
    """Return the decreasing singular values of the Jacobian of the independent conditions."""
    x = to_floats(method.coefficients)
    derivatives = conditions.jacobian(method.layout, x, order, independent=True)
    return np.asarray(np.linalg.svd(derivatives, compute_uv=False))


def largest_coefficient(method: Method) -> float:
    """Return the largest absolute value of an entry of a and b."""
    return float(max(np.abs(method.a).max(), np.abs(method.b).max()))


def coefficient_table(title: str, method: Data, places: int = 16) -> Table:
    """Return a table of coefficients in columns, with a number of decimals."""
    pairs = [[label, fixed(value, places)] for label, value in method["coefficients"]]
    depth = -(-len(pairs) // _COLUMNS)
    pairs += [["", ""]] * (depth * _COLUMNS - len(pairs))
    rows = [
        [cell for column in range(_COLUMNS) for cell in pairs[column * depth + k]]
        for k in range(depth)
    ]
    return Table(title, ("coefficient", "value") * _COLUMNS, rows, folded=True)


_SOLVED = 1e-5  # units of the last place, to which conditions are to hold


@dataclass(frozen=True)
class Printed:
    """A method as the paper prints it, digit for digit, with the strictly lower rows of a."""

    name: str
    a: tuple[tuple[str, ...], ...]
    b: tuple[str, ...]
    c: tuple[str, ...]

    def labelled(self) -> Iterator[tuple[str, str]]:
        """Yield every coefficient's label, such as ``a_3,2``, and its printed digits."""
        for i, row in enumerate(self.a, 1):
            for j, entry in enumerate(row, 1):
                yield f"a_{i},{j}", entry
        for letter, numbers in (("b", self.b), ("c", self.c)):
            for i, entry in enumerate(numbers, 1):
                yield f"{letter}_{i}", entry


@cache
def printed() -> dict[str, Printed]:
    """Return the methods of Appendix A by name, in the paper's order."""
    text = files(__package__).joinpath("appendix_a.toml").read_text(encoding="utf-8")
    return {
        name: Printed(name, tuple(map(tuple, entry["a"])), tuple(entry["b"]), tuple(entry["c"]))
        for name, entry in tomllib.loads(text).items()
    }


def compare(name: str, method: Method | None = None) -> list[tuple[str, str, Fraction]]:
    """Return each coefficient of CG4a, CG5a or CG6a: label, printed digits, value of a method.

    The method is by default the one of this name in the catalogue. Values for c are exact sums of
    rows of a. KeyError if the paper has no such method; ValueError if numbers of stages differ.
    """
    paper, method = printed()[name], methods[name] if method is None else method
    if method.stages != len(paper.b):
        raise ValueError(f"method must have {len(paper.b)} stages, got {method.stages}")
    pairs = zip(paper.labelled(), _values(method), strict=True)
    return [(label, digits, value) for (label, digits), value in pairs]


def nearest_exact(name: str, method: Method | None = None, *, truncated: bool) -> float:
    """Return by how much, at least, exact methods differ from printed coefficients.

    This is the largest difference of a coefficient from the middle of what is truncated, or else
    rounded, to the printed digits, in units of the last place: up to 0.5 where printed digits may
    be those of an exact method. It is computed to first order, by linear programming; zeros are
    kept. `name` is CG4a or CG5a, `method` has printed coefficients, by default the paper's.
    """
    method = method or Tableau(printed()[name].a, printed()[name].b)
    order, unit = methods[name].order, Fraction(1, 10**16)
    x = to_floats(method.coefficients)
    exact = conditions.residuals(method, order, arithmetic="exact")
    residuals = np.array([float(r / unit) for r in exact])
    slopes = conditions.jacobian(method.layout, x, order, independent=False)
    middle = 0.5 * np.sign(x) if truncated else np.zeros_like(x)
    # least d such that |step - middle| <= d and |residuals + slopes step| is next to nothing
    ones, nothing = np.ones((x.size, 1)), np.zeros((residuals.size, 1))
    left = np.block(
        [[np.eye(x.size), -ones], [-np.eye(x.size), -ones], [slopes, nothing], [-slopes, nothing]]
    )
    right = np.concatenate([middle, -middle, _SOLVED - residuals, _SOLVED + residuals])
    bounds = [*((None, None) if entry else (0.0, 0.0) for entry in x), (0.0, None)]
    solution = linprog(np.eye(x.size + 1)[-1], A_ub=left, b_ub=right, bounds=bounds)
    assert solution.fun is not None
    return float(solution.fun)
