"""Proofs that there is a zero in a certificate's box, and that all conditions hold there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from flint import arb, arb_mat

from ..method.tolerance import TOLERANCE_FACTOR
from ..support.balls import to_ball
from ..support.parsing import read_fraction
from .certificate import Certificate, CertificationError
from .dependent.orthogonality import Condition, follow
from .dependent.words import condition_words, text
from .krawczyk import KrawczykTest, krawczyk, to_double
from .statement import (
    Packed,
    free_of,
    left_out_of,
    orders_of,
    structure_of,
    system_of,
)
from .systems import EquationSystem, condition, exact_residuals, order_system

_SHARP = "1e-45"  # radius of balls that hold a zero
_MAX_IMAGES = 3


def prove_box(packed: Packed, certificate: Certificate) -> None:
    """Prove that all conditions have a zero in the box of a certificate, or raise."""
    check_left_out(packed, certificate, prove_zero(packed, certificate))


def prove_zero(packed: Packed, certificate: Certificate) -> KrawczykTest:
    """Prove that the equations of a certificate have exactly one zero in its box, or raise."""
    system = system_of(packed, certificate)
    free = free_of(packed, certificate)
    if len(free) != len(system.equations):
        raise CertificationError(
            "there must be as many free coefficients as equations",
            free=len(free),
            equations=len(system.equations),
        )
    y = packed.balls()
    conditions = order_system(packed.layout, certificate.order, certificate.embedded_order)
    values, jacobian = conditions.linearise(y)
    check_places(packed, conditions, values, jacobian)
    attempt = krawczyk(system, y, free, arb(certificate.radius))
    if not attempt.proved:
        raise CertificationError(f"{certificate.name}: no zero is proved", **quantities(attempt))
    return attempt


def check_left_out(packed: Packed, certificate: Certificate, attempt: KrawczykTest) -> None:
    """Prove that the conditions that are left out hold at a zero of the others that is proved."""
    left_out, name, bound = left_out_of(certificate)
    structure = structure_of(packed, certificate, name)
    if not left_out:
        return
    if structure and set(structure.assumed) & set(left_out):
        raise CertificationError(f"{certificate.name}: {name} assumes conditions that are left out")
    zero = zero_of(packed, certificate, attempt)
    known = list(structure.relations(zero)) if structure else []
    if bound:
        largest = largest_residual(packed, left_out, zero)
        if not largest < to_ball(read_fraction(bound)):
            raise CertificationError(
                f"{certificate.name}: that conditions are small is not proved",
                residual=float(largest),
            )
    elif not follow(packed.layout, orders_of(certificate), zero, left_out, known):
        raise CertificationError(
            f"{certificate.name}: that conditions follow from others is not proved",
            left_out=len(left_out),
        )


def zero_of(packed: Packed, certificate: Certificate, attempt: KrawczykTest) -> list[arb]:
    """Return balls around the zero that a test proved: the map's image, again while it is wide."""
    free = free_of(packed, certificate)
    zero = packed.balls()
    image = attempt.image
    for _ in range(_MAX_IMAGES):
        widest = max((ball.rad() for ball in image), key=float)
        if widest < arb(_SHARP):
            break
        for k, ball in zip(free, image, strict=True):
            zero[k] = ball.mid()
        # the zero is in this box, and the map takes it to itself
        again = krawczyk(system_of(packed, certificate), zero, free, widest.upper())
        if not again.image:
            break
        image = again.image
    for k, ball in zip(free, image, strict=True):
        zero[k] = ball
    return zero


def largest_residual(packed: Packed, some: Sequence[Condition], y: Sequence[arb]) -> arb:
    """Return an upper bound of the residuals of conditions, for coefficients in balls."""
    layout = packed.layout
    equations = tuple(condition(word, layout.stages + row) for row, word in some)
    values = EquationSystem(layout, equations).residuals(y)
    return max((abs(value).upper() for value in values), key=float)


def quantities(attempt: KrawczykTest) -> dict[str, float]:
    """Return the quantities of a test for messages."""
    return {
        "radius": float(attempt.radius),
        "ratio": attempt.ratio,
        "correction": attempt.correction,
        "contraction": attempt.contraction,
    }


def check_places(
    packed: Packed, system: EquationSystem, values: Sequence[arb], jacobian: arb_mat
) -> None:
    """Refuse coefficients that are further off than their last places can explain.

    Otherwise a solution close to wrong coefficients would pass as theirs.
    """
    units = np.array([float(coefficient.unit) for coefficient in packed.coefficients])
    allowed = TOLERANCE_FACTOR * (np.abs(to_double(jacobian)) @ units)
    for equation, value, bound in zip(system.equations, values, allowed, strict=True):
        if not abs(value) <= float(bound):
            raise CertificationError(
                f"the condition of {equation.label} is violated by more than the last places "
                "of the coefficients can explain",
                residual=float(abs(value).upper()),
                allowed=float(bound),
            )


def check_rational(packed: Packed, certificate: Certificate) -> None:
    """Prove that all residuals are zero; raise CertificationError that names the first nonzero."""
    for r, order in enumerate(orders_of(certificate), packed.layout.stages):
        words = condition_words(order, True, packed.layout.of_time)
        for word, residual in zip(
            words, exact_residuals(packed.layout, packed.values, words, r), strict=True
        ):
            if residual != 0:
                raise CertificationError(
                    f"{certificate.name}: the condition of {text(word)} is violated",
                    residual=float(residual),
                )
