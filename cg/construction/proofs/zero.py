"""Proofs that there is a zero in a box, and that all conditions hold there.

Krawczyk's test (`krawczyk`) needs as many equations as unknowns: some coefficients are fixed, some
conditions left out. It proves one zero z of the others within ``radius`` of the coefficients. The
conditions left out are then either shown to follow from the others (`dependent`), or to be below
``bound`` at z, enclosed in balls of `places` decimal places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from cg.construction.conditions.exact import Condition, tree_text
from cg.construction.methods.tolerance import TOLERANCE_FACTOR
from cg.construction.proofs.certificate import Box, CertificationError
from cg.construction.proofs.dependent.orthogonality import prove_dependent
from cg.construction.proofs.krawczyk import KrawczykTest, doubles, enclose_zero, krawczyk, max_abs
from cg.construction.proofs.packed import PackedMethod, PackedWeights
from cg.support import flint
from cg.support.quads import to_ball, to_flint, to_fraction, working_precision

SHARP_PLACES = 45
"""Decimal places of balls around a zero, in which relations between residuals are evaluated."""

_GUARD_PLACES = 12  # beyond those to which residuals are shown to be small


def prove_zero(packed: PackedMethod, box: Box) -> KrawczykTest:
    """Prove that the equations have exactly one zero in a box, or raise."""
    system = packed.system(box.left_out)
    movable = packed.movable(box)
    equations = len(packed.conditions) - len(box.left_out)
    if len(movable) != equations:
        raise CertificationError(
            "there must be as many movable coefficients as equations",
            movable=len(movable),
            equations=equations,
        )
    y = packed.balls()
    at_point = packed.system().linearise(y)
    check_places(packed, *at_point)
    kept = packed.without(at_point, box.left_out)
    test = krawczyk(system, y, movable, to_ball(Fraction(box.radius)), at_point=kept)
    if not test.proved:
        raise CertificationError(f"{packed.name}: no zero is proved", **test.quantities)
    return test


def check_left_out(packed: PackedMethod, box: Box, test: KrawczykTest, bits: int) -> None:
    """Prove what a box says of the conditions that are left out, at the zero of the others."""
    if not box.left_out:
        return
    if box.bound is None:
        assert isinstance(packed, PackedWeights)  # others leave none out
        zero = zero_of(packed, box, test, SHARP_PLACES)
        if not prove_dependent(packed.layout, packed.orders, zero, box.left_out):
            raise CertificationError(
                f"{packed.name}: that conditions follow from others is not proved",
                left_out=len(box.left_out),
            )
        return
    largest = max_residual(packed, box, test, -box.bound.adjusted(), bits)
    if not largest < to_ball(Fraction(box.bound)):
        raise CertificationError(
            f"{packed.name}: that conditions are small is not proved", residual=float(largest)
        )


def zero_of(packed: PackedMethod, box: Box, test: KrawczykTest, places: int) -> list[flint.arb]:
    """Return balls with radii below ``10**-places`` around the zero that a test proved."""
    system, movable = packed.system(box.left_out), packed.movable(box)
    return enclose_zero(system, packed.balls(), movable, test, places)


def max_residual(
    packed: PackedMethod, box: Box, test: KrawczykTest, places: int, bits: int
) -> flint.arb:
    """Return an upper bound of the residuals that are left out, at the zero of the others."""
    places += _GUARD_PLACES
    with working_precision(bits_of(places, bits)):
        zero = zero_of(packed, box, test, places)
        return max_abs(packed.equations(box.left_out).residuals(zero))


def bits_of(places: int, bits: int) -> int:
    """Return the precision that decimal places need, with the bits of a certificate as a guard."""
    return math.ceil(math.log2(10) * places) + bits


def check_places(
    packed: PackedMethod, values: Sequence[flint.arb], jacobian: flint.arb_mat
) -> None:
    """Refuse coefficients that are further off than their last places can explain.

    Otherwise a solution close to wrong coefficients would pass as theirs.
    """
    units = np.array([float(coefficient.unit) for coefficient in packed.coefficients])
    allowed = TOLERANCE_FACTOR * (np.abs(doubles(jacobian.tolist())) @ units)
    for condition, value, bound in zip(packed.conditions, values, allowed, strict=True):
        if not value.abs_lower() <= float(bound):
            raise CertificationError(
                f"the condition of {label(condition)} is violated by more than the last places "
                "of the coefficients can explain",
                residual=float(abs(value).upper()),
                allowed=float(bound),
            )


def check_rational(packed: PackedMethod) -> None:
    """Prove that all residuals are zero; raise CertificationError that names the first nonzero."""
    residuals = packed.system().residuals([to_flint(x.value) for x in packed.coefficients])
    for condition, residual in zip(packed.conditions, residuals, strict=True):
        if residual != 0:
            raise CertificationError(
                f"{packed.name}: the condition of {label(condition)} is violated",
                residual=float(to_fraction(residual)),
            )


def label(condition: Condition) -> str:
    """Return a condition's tree in brackets, and whether it is one of second weights."""
    return tree_text(condition.word) + " embedded" * condition.row
