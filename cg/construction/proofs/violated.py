"""Proofs that the order of a method isn't higher: a condition of the next one is violated.

The lower bound of ``|Φ(w) - 1/γ(w)|`` over all coefficients in the box, in ball arithmetic, must be
at least `_MIN_BOUND`: so it holds for the exact solution in the box, wherever that is.
"""

from collections.abc import Sequence
from decimal import ROUND_FLOOR, Context, Decimal
from fractions import Fraction

from cg.construction.conditions.word_weights import EquationSystem
from cg.construction.conditions.words import Condition, Word, condition_words, is_of_time, nodes
from cg.construction.proofs.certificate import (
    Box,
    Certificate,
    CertificationError,
    ViolatedCondition,
)
from cg.construction.proofs.statement import Packed
from cg.support.balls import exact_midpoint

_MIN_BOUND = Fraction(1, 10**9)  # a smaller violation is a slip in the coefficients
_ROUNDED_DOWN = Context(prec=3, rounding=ROUND_FLOOR)


def find_beyond(packed: Packed, box: Box) -> list[ViolatedCondition]:
    """Return the condition of the next order that is violated most, of each row of weights."""
    violations: list[ViolatedCondition] = []
    for row, order in enumerate(packed.orders):
        every = condition_words(order + 1, True, packed.layout.of_time)
        words = [w for w in every if nodes(w) == order + 1]
        bounds = _bounds(packed, box, words, row)
        best = max(range(len(words)), key=lambda k: bounds[k])
        if bounds[best] < _MIN_BOUND:
            raise CertificationError(
                f"{packed.name}: no condition of order {order + 1} is violated by much, "
                f"so order {order} isn't the highest, or coefficients are wrong",
                largest_bound=float(bounds[best]),
            )
        numerator, denominator = map(Decimal, bounds[best].as_integer_ratio())
        violations.append(
            ViolatedCondition(words[best], _ROUNDED_DOWN.divide(numerator, denominator))
        )
    return violations


def check_beyond(packed: Packed, certificate: Certificate) -> None:
    """Prove that conditions of the next orders are violated; CertificationError if they aren't."""
    claims = [certificate.beyond, certificate.embedded_beyond]
    for row, (order, claim) in enumerate(zip(packed.orders, claims, strict=False)):
        if claim is None:
            raise CertificationError("second weights need a condition that they violate")
        if nodes(claim.word) != order + 1:
            raise CertificationError(
                f"{claim.tree} must have {order + 2} nodes to tell of order {order + 1}"
            )
        if packed.layout.of_time and not is_of_time(claim.word):
            raise CertificationError(f"{claim.tree} is no condition for linear equations")
        bound = _bounds(packed, certificate.box, [claim.word], row)[0]
        if not bound >= Fraction(claim.bound) >= _MIN_BOUND:
            raise CertificationError(
                f"{packed.name}: the condition of {claim.tree} isn't violated by as much as "
                f"{claim.bound}",
                bound=float(bound),
            )


def _bounds(packed: Packed, box: Box, words: Sequence[Word], row: int) -> list[Fraction]:
    """Return lower bounds of the residuals' magnitudes in the box."""
    system = EquationSystem(packed.layout, tuple(Condition(row, word) for word in words))
    values = system.residuals(packed.enclosure(box))
    return [exact_midpoint(value.abs_lower()) for value in values]
