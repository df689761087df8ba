"""Steps of given methods, one after the other, as one method."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from typing import Any

from ..tableau import Tableau

__all__ = ["compose", "triple_jump"]


def compose(
    methods: Sequence[Tableau], gammas: Sequence[Any], *, name: str = "", source: str = ""
) -> Tableau:
    """Compose steps of lengths ``γ_k h`` into one method.

    Rows of later steps begin with the weights of the earlier ones, scaled.

    Parameters
    ----------
    methods : sequence of Tableau
        Explicit methods, in the order in which they are applied.
    gammas : sequence of numbers
        As many; anything that `fractions.Fraction` takes.
    name, source : str, optional

    Returns
    -------
    Tableau
        With the sum of all stages; its coefficients are exact products.

    Raises
    ------
    ValueError
        If the numbers of methods and lengths differ, there is none, or one is implicit.
    """
    if not methods or len(methods) != len(gammas):
        raise ValueError(
            f"gammas must have one entry a method, got {len(gammas)} for {len(methods)} methods"
        )
    rows: list[list[Fraction]] = []
    before: list[Fraction] = []
    for method, gamma in zip(methods, gammas, strict=True):
        if not method.explicit:
            raise ValueError(f"methods must be explicit, got {method!r}")
        length = Fraction(gamma)
        a, b = method.exact
        rows += [[*before, *(length * entry for entry in row[:i])] for i, row in enumerate(a)]
        before = before + [length * entry for entry in b]
    return Tableau(rows, before, name=name, source=source)


def triple_jump(order: int, digits: int = 60) -> tuple[Fraction, Fraction, Fraction]:
    """Return the lengths of three steps of order q that make one of order q + 1, q even.

    ``γ_1 = γ_3 = 1/(2 - 2^{1/(q+1)})``, ``γ_2 = 1 - 2 γ_1``, rounded to so many digits.
    """
    if order < 2 or order % 2:
        raise ValueError(f"order must be even and positive, got {order}")
    with localcontext() as context:
        context.prec = digits
        root = Decimal(2) ** (1 / Decimal(order + 1))
        outer = Fraction(1 / (2 - root))
    return outer, 1 - 2 * outer, outer
