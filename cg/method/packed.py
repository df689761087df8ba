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
    """Return the method with a layout and packed coefficients.

    Parameters
    ----------
    layout : Layout
        Of a tableau, which makes a `Tableau`, of nodes, which makes a `MagnusMethod`, or of points,
        which makes a `CommutatorFree`.
    coefficients : sequence of layout.size numbers
        As `Coefficient.read` takes them.
    digits : int, optional
        Round to this many significant decimals. Without it, Fractions count as exact.
    **fields
        Further keyword arguments of the class, such as `name` and `source`.

    Raises
    ------
    ValueError
        If there are too few or too many coefficients.
    MethodError
        If the method would be wrong; of tableaux a `TableauError`.

    Examples
    --------
    >>> make_method(Layout.tableau(2), ["1/2", 0, 1], name="midpoint")
    <Tableau midpoint: order 2, 2 evaluations, 2 flows>
    """
    check_length(coefficients, layout.size)
    if digits is not None:
        coefficients = [to_decimal(Coefficient.read(x).value, digits) for x in coefficients]
    points = MagnusMethod if layout.of_time else CommutatorFree
    kind = points if layout.rows is None else Tableau
    return kind.from_layout(layout, coefficients, **fields)
