"""The statement of a certificate: conditions, unknowns and box.

It reads: the coefficients y of the method, except those that `box` fixes, can be changed by at most
``box.radius`` so that all `conditions` of `orders` hold. Whether a certificate fits its method is
checked here before anything is proved.
"""

from __future__ import annotations

from collections.abc import Sequence

from cg.construction.conditions import MAX_ORDER
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.splitting import Splitting
from cg.construction.proofs.certificate import Certificate, CertificationError
from cg.construction.proofs.packed import Packed, PackedWeights
from cg.construction.proofs.packed_brackets import PackedBrackets
from cg.construction.proofs.packed_splitting import PackedSplitting

_MAX_BITS = 1 << 14


def pack(method: Method, orders: Sequence[int]) -> Packed:
    """Pack a method, with its second result if it is a pair."""
    if isinstance(method, Splitting):
        return PackedSplitting.of(method, orders)
    if isinstance(method, MagnusMethod) and method.brackets:
        return PackedBrackets(method.name, method.coefficients, tuple(orders), method)
    return PackedWeights(method.name, method.coefficients, tuple(orders), method.layout)


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
    if pair != (method.embedded is not None):
        faults.append("second weights must be proved, and those of pairs only")
    orders = certificate.orders
    if not all(type(order) is int and 1 <= order <= MAX_ORDER for order in orders):
        faults.append(f"orders must be between 1 and {MAX_ORDER}")
    if not 53 <= certificate.bits <= _MAX_BITS:
        faults.append(f"bits must be between 53 and {_MAX_BITS}, got {certificate.bits}")
    if faults:
        raise CertificationError(f"the certificate doesn't fit: {'; '.join(faults)}")
    packed = pack(method, orders)
    box = certificate.box
    left_out = set(box.left_out)
    bounded = isinstance(packed, PackedWeights) or box.bound is not None
    known = packed.conditions if bounded else []
    if len(left_out) != len(box.left_out) or not left_out.issubset(known):
        raise CertificationError(
            "conditions that are left out must be distinct independent ones of these orders"
        )
    names = packed.names
    held = set(box.fixed)
    if len(held) != len(box.fixed) or not held.issubset(names):
        raise CertificationError("the fixed coefficients must be distinct ones of the method")
    if box.radius == 0 and (len(held) != len(names) or left_out):
        raise CertificationError(
            "a radius of 0 needs all coefficients fixed and no condition left out"
        )
    for name, coefficient in zip(names, packed.coefficients, strict=True):
        if coefficient.value == 0 and name not in held:
            raise CertificationError(f"{name} is exactly zero, so it must be fixed")
    return packed
