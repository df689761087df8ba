"""Methods made of a layout and a packed vector of coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..structure.layout import Layout, check_length
from ..support.quads import to_decimal
from .coefficients import Coefficient
from .commutator_free import CommutatorFree
from .magnus import MagnusMethod
from .tableau import Tableau


def make_method(
    layout: Layout, coefficients: Sequence[Any], *, digits: int | None = None, **fields: Any
) -> Tableau | CommutatorFree | MagnusMethod:
    """Return the method with a layout and packed coefficients, which `Coefficient.read` takes.

    A layout of a tableau makes a `Tableau`, of nodes a `MagnusMethod`, of points a
    `CommutatorFree`. Coefficients are rounded to `digits` significant decimals; without it,
    Fractions count as exact. Further `fields` are those of the class, such as `name` and `source`.
    """
    check_length(coefficients, layout.size)
    if digits is not None:
        coefficients = [to_decimal(Coefficient.read(x).value, digits) for x in coefficients]
    points = MagnusMethod if layout.of_time else CommutatorFree
    kind = points if layout.rows is None else Tableau
    return kind.from_layout(layout, coefficients, **fields)
