"""Coefficients of methods as data for results.json and as tables for the page."""

from decimal import Context as DecimalContext
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np

from cg import conditions
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
