"""The statement of a certificate: conditions, unknowns and box.

It reads: the coefficients y of the method, except those that `box` fixes, can be changed by at most
``box.radius`` so that all `conditions` of `orders` hold. Whether a certificate fits its method is
checked here before anything is proved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from cg.construction.conditions import MAX_ORDER
from cg.construction.conditions.word_weights import EquationSystem
from cg.construction.conditions.words import Condition, conditions_of
from cg.construction.layouts.layout import Layout
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.proofs.certificate import Box, Certificate, CertificationError
from cg.support import flint
from cg.support.balls import to_ball

_MAX_BITS = 1 << 14


@dataclass(frozen=True)
class Packed:
    """A method as a vector of coefficients, point by point, with the orders of its results."""

    name: str
    layout: Layout
    coefficients: tuple[Coefficient, ...]
    orders: tuple[int, ...]

    @property
    def conditions(self) -> list[Condition]:
        """The independent conditions of all rows of weights."""
        return conditions_of(self.orders, self.layout.of_time)

    def system(self, left_out: Sequence[Condition] = ()) -> EquationSystem:
        """Return the conditions as equations, without those that are left out."""
        omitted = set(left_out)
        kept = tuple(one for one in self.conditions if one not in omitted)
        return EquationSystem(self.layout, kept)

    def balls(self) -> list[flint.arb]:
        """Return balls, as small as the precision allows, that hold the values."""
        return [to_ball(coefficient.value) for coefficient in self.coefficients]

    def movable(self, box: Box) -> list[int]:
        """Return the indices of the coefficients that aren't fixed."""
        held = set(box.fixed)
        return [k for k, name in enumerate(self.layout.names) if name not in held]

    def enclosure(self, box: Box) -> list[flint.arb]:
        """Return balls that hold the exact solution."""
        y = self.balls()
        radius = to_ball(Fraction(box.radius)).upper()
        for k in self.movable(box):
            y[k] = y[k] + flint.arb(0, radius)
        return y


def fitting(certificate: Certificate, method: Method) -> Packed:
    """Return the packed method; raise CertificationError if the certificate is for another one."""
    if isinstance(method, MuntheKaas):
        raise CertificationError(
            f"the certificate doesn't fit: method must not be a Munthe-Kaas method, got {method!r}"
        )
    pair = certificate.embedded_order is not None
    faults = []
    if certificate.name != method.name:
        faults.append(f"it is for {certificate.name!r}, not for {method.name!r}")
    if pair != method.layout.pair:
        faults.append("second weights must be proved, and those of pairs only")
    orders = certificate.orders
    if not all(type(order) is int and 1 <= order <= MAX_ORDER for order in orders):
        faults.append(f"orders must be between 1 and {MAX_ORDER}")
    if not 53 <= certificate.bits <= _MAX_BITS:
        faults.append(f"bits must be between 53 and {_MAX_BITS}, got {certificate.bits}")
    if faults:
        raise CertificationError(f"the certificate doesn't fit: {'; '.join(faults)}")
    packed = Packed(method.name, method.layout, method.coefficients, orders)
    box = certificate.box
    left_out = set(box.left_out)
    if len(left_out) != len(box.left_out) or not left_out.issubset(packed.conditions):
        raise CertificationError(
            "conditions that are left out must be distinct independent ones of these orders"
        )
    names = packed.layout.names
    held = set(box.fixed)
    if len(held) != len(box.fixed) or not held.issubset(names):
        raise CertificationError("the fixed coefficients must be distinct ones of the method")
    if box.radius == 0 and (len(held) != packed.layout.size or left_out):
        raise CertificationError(
            "a radius of 0 needs all coefficients fixed and no condition left out"
        )
    for name, coefficient in zip(names, packed.coefficients, strict=True):
        if coefficient.value == 0 and name not in held:
            raise CertificationError(f"{name} is exactly zero, so it must be fixed")
    return packed
