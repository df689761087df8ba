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
    a, b = method.exact
    c = [sum(row, Fraction(0)) for row in a]
    values = [entry for i, row in enumerate(a) for entry in row[:i]] + [*b, *c]
    return {
        "name": method.name,
        "coefficients": [
            [label, to_decimal(value)]
            for label, value in zip(labels(method.stages), values, strict=True)
        ],
        "largest_coefficient": largest_coefficient(method),
        "abscissae_in_unit_interval": all(0 <= entry <= 1 for entry in c),
        "condition_number": condition_number(method, order),
    }


def condition_number(method: Method, order: int) -> float | None:
    """Return the condition number of the Jacobian, or None if it has not full rank.

    The Jacobian is that of the independent conditions.
    """
    singular = singular_values(method, order)
    if singular[-1] <= RANK_THRESHOLD * singular[0]:
        return None
    return float(singular[0] / singular[-1])


def singular_values(method: Method, order: int) -> Array:
    """Return the decreasing singular values of the Jacobian of the independent conditions."""
    x = np.array([float(entry.value) for entry in method.coefficients])
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


@dataclass(frozen=True)
class Comparison:
    """One printed coefficient beside the exact value of the catalogue.

    The value for c is the exact sum of a row of a.
    """

    label: str
    printed: str
    ours: Fraction

    @property
    def difference(self) -> Fraction:
        """Ours minus the paper's, exactly."""
        return self.ours - Fraction(self.printed)

    @property
    def units(self) -> float:
        """The difference in units of the last printed place."""
        places = len(self.printed.partition(".")[2])
        return float(self.difference * 10**places)

    @property
    def kept_zero(self) -> bool:
        """Whether ours is an exact zero wherever the paper prints one."""
        return Fraction(self.printed) != 0 or self.ours == 0


@cache
def printed() -> dict[str, Printed]:
    """Return the methods of Appendix A by name, in the paper's order."""
    text = files(__package__).joinpath("appendix_a.toml").read_text(encoding="utf-8")
    return {
        name: Printed(name, tuple(map(tuple, entry["a"])), tuple(entry["b"]), tuple(entry["c"]))
        for name, entry in tomllib.loads(text).items()
    }


def compare(name: str, method: Tableau | None = None) -> tuple[Comparison, ...]:
    """Set every printed coefficient of CG4a, CG5a or CG6a beside that of a method.

    The method is by default the one of this name in the catalogue. The order is a row by row, then
    b, then c. KeyError if the paper has no such method; ValueError if the numbers of stages differ.
    """
    paper = printed()[name]
    compared = methods[name] if method is None else method
    assert isinstance(compared, Tableau)
    if compared.stages != len(paper.b):
        raise ValueError(f"method must have {len(paper.b)} stages, got {compared.stages}")
    a, b = compared.exact
    ours = [entry for i, row in enumerate(a) for entry in row[:i]] + [*b, *map(sum, a)]
    return tuple(
        Comparison(label, digits, Fraction(value))
        for (label, digits), value in zip(paper.labelled(), ours, strict=True)
    )


def nearest_exact(name: str, method: Tableau | None = None, *, truncated: bool) -> float:
    """Return by how much, at least, exact methods differ from printed coefficients.

    This is the largest difference of a coefficient from the middle of what is truncated, or else
    rounded, to the printed digits, in units of the last place: up to 0.5 where printed digits may
    be those of an exact method. It is computed to first order, by linear programming; zeros are
    kept. `name` is CG4a or CG5a, `method` has printed coefficients, by default the paper's.
    """
    paper = printed()[name]
    digits = Tableau(paper.a, paper.b) if method is None else method
    order, unit = methods[name].order, Fraction(1, 10**16)
    x = np.array([float(entry.value) for entry in digits.coefficients])
    exact = conditions.residuals(digits, order, arithmetic="exact")
    residuals = np.array([float(r / unit) for r in exact])
    slopes = conditions.jacobian(digits.layout, x, order, independent=False)
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
