"""The statement of a certificate: equations, unknowns and box."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb
from numpy.typing import NDArray

from ..conditions import MAX_ORDER
from ..method.coefficients import Coefficient
from ..method.method import Method
from ..method.munthe_kaas import MuntheKaas
from ..structure.layout import Layout
from ..support.balls import to_ball
from .certificate import Certificate, CertificationError
from .dependent.structure import MethodStructure
from .explain import (
    STRUCTURES,
    LeftOut,
    augmented_system,
    read_identity,
    read_left_out,
    reduced_system,
)
from .systems import EquationSystem, order_system

_MAX_BITS = 1 << 14
_MAX_IDENTITIES = 100


@dataclass(frozen=True)
class Packed:
    """A method as a vector of coefficients: row by row, second weights last."""

    layout: Layout
    coefficients: tuple[Coefficient, ...]

    @classmethod
    def of(cls, method: Method) -> Packed:
        """Pack a method, with its second result if it is a pair."""
        return cls(method.layout, method.coefficients)

    @property
    def values(self) -> list[Fraction]:
        """The exact values."""
        return [coefficient.value for coefficient in self.coefficients]

    @property
    def preferences(self) -> NDArray[np.float64]:
        """How much each coefficient is preferred to be free: exact ones are held if possible."""
        return np.where([c.unit == 0 for c in self.coefficients], 1e-6, 1.0)

    def balls(self) -> list[arb]:
        """Return balls, as small as the precision allows, that hold the values."""
        return [to_ball(v) for v in self.values]

    def zeros(self) -> list[frozenset[int]]:
        """Return the stages at which each row of weights is exactly zero."""
        held = [k for k, coefficient in enumerate(self.coefficients) if coefficient.value == 0]
        rows = map(self.layout.row, range(self.layout.stages, len(self.layout.ends)))
        return [frozenset(self.layout.stage_of[k].item() for k in held if k in row) for row in rows]


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
    orders = orders_of(certificate)
    if not all(type(order) is int and 1 <= order <= MAX_ORDER for order in orders):
        faults.append(f"orders must be between 1 and {MAX_ORDER}")
    if not 53 <= certificate.bits <= _MAX_BITS:
        faults.append(f"bits must be between 53 and {_MAX_BITS}, got {certificate.bits}")
    if len(certificate.identities) > _MAX_IDENTITIES:
        faults.append(f"there may be at most {_MAX_IDENTITIES} identities")
    if faults:
        raise CertificationError(f"the certificate doesn't fit: {'; '.join(faults)}")
    packed = Packed.of(method)
    names = packed.layout.names
    held = set(certificate.fixed)
    if len(held) != len(certificate.fixed) or not held.issubset(names):
        raise CertificationError("the fixed coefficients must be distinct ones of the method")
    for name, coefficient in zip(names, packed.coefficients, strict=True):
        if coefficient.value == 0 and name not in held:
            raise CertificationError(f"{name} is exactly zero, so it must be fixed")
    return packed


def system_of(packed: Packed, certificate: Certificate) -> EquationSystem:
    """Return the equations of a certificate."""
    if not certificate.identities:
        return order_system(packed.layout, certificate.order, certificate.embedded_order)
    left_out, orders = left_out_of(certificate), orders_of(certificate)
    try:
        if left_out.conditions:
            structure = structure_of(packed, certificate, left_out.structure)
            more = structure.equations() if structure else []
            return reduced_system(packed.layout, orders, left_out.conditions, more)
        identities = [read_identity(name) for name in certificate.identities]
        return augmented_system(packed.layout, orders, identities, packed.zeros())
    except ValueError as error:
        raise CertificationError(str(error)) from None


def structure_of(packed: Packed, certificate: Certificate, name: str) -> MethodStructure | None:
    """Return the structure of a method; CertificationError if it hasn't that one."""
    if not name:
        return None
    structure = STRUCTURES[name](packed.layout, orders_of(certificate), packed.values)
    if not structure.satisfied():
        raise CertificationError(f"{certificate.name}: it has no {name} of this order")
    return structure


def left_out_of(certificate: Certificate) -> LeftOut:
    """Return the conditions that are no equations; CertificationError if they can't be read."""
    try:
        return read_left_out(certificate.identities)
    except (ValueError, TypeError, ZeroDivisionError) as error:
        raise CertificationError(str(error)) from None


def orders_of(certificate: Certificate) -> list[int]:
    """Return the orders of all rows of weights."""
    embedded = certificate.embedded_order
    return [certificate.order] if embedded is None else [certificate.order, embedded]


def free_of(packed: Packed, certificate: Certificate) -> list[int]:
    """Return the indices of the coefficients that aren't fixed."""
    held = set(certificate.fixed)
    return [k for k, name in enumerate(packed.layout.names) if name not in held]


def box(packed: Packed, certificate: Certificate) -> list[arb]:
    """Return balls that hold the exact solution."""
    y = packed.balls()
    radius = arb(certificate.radius).upper()
    for k in free_of(packed, certificate):
        y[k] = y[k] + arb(0, radius)
    return y
