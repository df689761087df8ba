"""Composition of methods: consecutive steps as one method."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import chain
from typing import Any

import numpy as np

from ..method.coefficients import Coefficient
from ..method.tableau import Tableau
from ..support.checks import check_integer
from ..support.quads import to_decimal

__all__ = ["compose", "triple_jump"]

_MAX_DIGITS = 4000  # Python's default limit for the digits of an integer


def compose(
    methods: Sequence[Tableau], gammas: Sequence[Any], *, name: str = "", source: str = ""
) -> Tableau:
    """Compose steps of lengths ``γ_k h`` into one method.

    Rows of later steps begin with the scaled weights of the earlier ones.

    Parameters
    ----------
    methods : sequence of Tableau
        Explicit methods, in the order in which they are applied.
    gammas : sequence of numbers
        Lengths of the steps, one for each method; integers, Fractions or text, as for
        `cg.method.coefficients.Coefficient.read`.
    name, source : str, optional

    Returns
    -------
    Tableau
        The composition, whose stages are those of all methods together. Its coefficients are
        rational if all coefficients and lengths are, otherwise decimals with 36 digits.

    Raises
    ------
    TypeError
        If `methods` isn't a sequence of tableaux, or `gammas` isn't a sequence.
    ValueError
        If the numbers of methods and lengths differ or are zero, a length isn't a finite number,
        or a method is implicit.
    """
    for label, value in (("methods", methods), ("gammas", gammas)):
        if isinstance(value, str | bytes) or not isinstance(value, Sequence | np.ndarray):
            raise TypeError(f"{label} must be a sequence, got {value!r}")
        if isinstance(value, np.ndarray) and value.ndim == 0:
            raise TypeError(f"{label} must be a sequence, got {value!r}")
    if not len(methods) or len(methods) != len(gammas):
        raise ValueError(
            f"gammas must have one entry for each method, got {len(gammas)} for {len(methods)} "
            "methods"
        )
    rows: list[list[Fraction]] = []
    before: list[Fraction] = []
    inputs: list[Coefficient] = []
    for k, (method, gamma) in enumerate(zip(methods, gammas, strict=True)):
        if not isinstance(method, Tableau):
            raise TypeError(f"methods[{k}] must be a Tableau, got {method!r}")
        if not method.explicit:
            raise ValueError(f"methods must be explicit, got {method!r}")
        try:
            scale = Coefficient.read(gamma)
        except ValueError as error:
            raise ValueError(f"gammas[{k}]: {error}") from None
        inputs += [scale, *method.weights, *chain.from_iterable(method.entries)]
        length = scale.value
        a, b = method.exact
        rows += [[*before, *(length * entry for entry in row[:i])] for i, row in enumerate(a)]
        before = before + [length * entry for entry in b]
    if all(coefficient.unit == 0 for coefficient in inputs):
        return Tableau(rows, before, name=name, source=source)
    digits = [[to_decimal(entry) for entry in row] for row in rows]
    return Tableau(digits, [to_decimal(entry) for entry in before], name=name, source=source)


def triple_jump(order: int, digits: int = 60) -> tuple[str, str, str]:
    """Return the lengths of three steps of order q that make one of order q + 1, q even.

    ``γ_1 = γ_3 = 1/(2 - 2^{1/(q+1)})``, ``γ_2 = 1 - 2 γ_1``, in decimal with `digits` digits
    (E. Hairer, C. Lubich, G. Wanner, *Geometric Numerical Integration*, II.4).
    """
    order = check_integer("order", order, 1)
    digits = check_integer("digits", digits, 1, _MAX_DIGITS)
    if order % 2:
        raise ValueError(f"order must be even and positive, got {order}")
    with localcontext() as context:
        context.prec = digits
        root = Decimal(2) ** (1 / Decimal(order + 1))
        outer = 1 / (2 - root)
        return str(outer), str(1 - 2 * outer), str(outer)
