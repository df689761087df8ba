"""Methods made of a layout and a packed vector of coefficients."""

from collections.abc import Sequence
from typing import Any

from cg.construction.layouts.layout import Layout, check_length
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.tableau import Tableau


def make_method(
    layout: Layout, coefficients: Sequence[Any], **fields: Any
) -> Tableau | CommutatorFree | MagnusMethod:
    """Return the method with a layout and packed coefficients, which `Coefficient.read` takes."""
    check_length(coefficients, layout.size)
    points = MagnusMethod if layout.of_time else CommutatorFree
    kind = points if layout.rows is None else Tableau
    return kind.from_layout(layout, coefficients, **fields)
