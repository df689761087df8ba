"""Proofs that the order of a method isn't higher: a condition of the next one is violated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

from ..support.balls import exact_midpoint, to_ball
from ..support.quads import to_decimal
from .certificate import Certificate, CertificationError, ViolatedCondition
from .dependent.words import (
    Word,
    condition_words,
    is_of_time,
    nodes,
    parse,
    reciprocal_density,
    text,
)
from .statement import Packed, box, orders_of
from .weights import Quantity, Weights

_MIN_BOUND = Fraction(1, 10**9)  # a smaller violation is a slip in the coefficients


def find_beyond(packed: Packed, draft: Certificate) -> Certificate:
    """Return a draft with the conditions of the next orders that are violated most."""
    violations: list[ViolatedCondition] = []
    for r, order in enumerate(orders_of(draft)):
        every = condition_words(order + 1, True, packed.layout.of_time)
        words = [w for w in every if nodes(w) == order + 1]
        bounds = _bounds(packed, draft, words, packed.layout.stages + r)
        best = max(range(len(words)), key=lambda k: bounds[k])
        if bounds[best] < _MIN_BOUND:
            raise CertificationError(
                f"{draft.name}: no condition of order {order + 1} is violated by much, "
                f"so order {order} isn't the highest, or coefficients are wrong",
                largest_bound=float(bounds[best]),
            )
        violations.append(ViolatedCondition(text(words[best]), _rounded_down(bounds[best])))
    second = violations[1] if len(violations) > 1 else None
    return replace(draft, beyond=violations[0], embedded_beyond=second)


def check_beyond(packed: Packed, certificate: Certificate) -> None:
    """Prove that conditions of the next orders are violated; CertificationError if they aren't."""
    claims = [certificate.beyond, certificate.embedded_beyond]
    for r, (order, claim) in enumerate(zip(orders_of(certificate), claims, strict=False)):
        if claim is None:
            raise CertificationError("second weights need a condition that they violate")
        try:
            word = parse(claim.tree)
        except ValueError as error:
            raise CertificationError(str(error)) from None
        if nodes(word) != order + 1:
            raise CertificationError(
                f"{claim.tree} must have {order + 2} nodes to tell of order {order + 1}"
            )
        if packed.layout.of_time and not is_of_time(word):
            raise CertificationError(f"{claim.tree} is no condition for linear equations")
        bound = _bounds(packed, certificate, [word], packed.layout.stages + r)[0]
        if not bound >= Fraction(claim.bound) >= _MIN_BOUND:
            raise CertificationError(
                f"{certificate.name}: the condition of {claim.tree} isn't violated by as much as "
                f"{claim.bound}",
                bound=float(bound),
            )


def _bounds(
    packed: Packed, certificate: Certificate, words: Sequence[Word], row: int
) -> list[Fraction]:
    """Return lower bounds of the residuals' magnitudes in the box."""
    weights = Weights(packed.layout, [Quantity(row, word) for word in words])
    bounds = []
    for value, word in zip(weights.evaluate(box(packed, certificate)), words, strict=True):
        target = reciprocal_density(word)
        bounds.append(exact_midpoint((value - to_ball(target)).abs_lower()))
    return bounds


def _rounded_down(value: Fraction) -> str:
    """Write a positive number with three digits, no more than it is."""
    unit = Fraction(10) ** (math.floor(math.log10(value)) - 2)
    return to_decimal(value // unit * unit, 4)
