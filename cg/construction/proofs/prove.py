"""Proofs that a method has an order: `certify` finds them, `check` repeats them."""

import math
from decimal import Decimal

from cg.construction.catalogue import resolve_method
from cg.construction.conditions import MAX_ORDER
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.splitting import Splitting
from cg.construction.proofs.certificate import Box, Certificate, CertificationError
from cg.construction.proofs.find import find_box
from cg.construction.proofs.statement import Packed, fitting
from cg.construction.proofs.violated import check_beyond, find_beyond
from cg.construction.proofs.zero import check_left_out, check_rational, prove_zero
from cg.support.balls import working_precision as precision
from cg.support.checks import check_flag, check_integer

_GUARD_BITS = 136  # beyond the stored places: conditioning, and room for a tight radius


def certify(
    method: Method | str, order: int | None = None, *, complete: bool = False
) -> Certificate:
    """Prove the order of a method.

    Shows by Krawczyk's test in ball arithmetic that close to the stored coefficients there
    is an exact solution of the order conditions, and that one of the next order is
    violated. Rational methods are proved in rational arithmetic.

    Parameters
    ----------
    method
        A name is looked up in the catalogue. Second weights of a pair are proved as well.
    order
        By default the order of the method. It must be the order exactly.
    complete
        Raise CertificationError unless all conditions are proved.

    Returns
    -------
    Certificate
        Where conditions depend on others for unknown reasons, it is a proof in part, and its
        attribute `complete` is false: as many conditions as are independent have a zero close
        to the stored coefficients, and the others are below a bound there, mostly 1e-300.

    Raises
    ------
    CertificationError
        If there is no proof; with the quantities that tell why.

    Examples
    --------
    >>> certify("CG3").order
    3
    """
    method = resolve_method(method)
    complete = check_flag("complete", complete)
    if isinstance(method, MuntheKaas):
        raise TypeError(
            f"method must not be a Munthe-Kaas method, whose order is that of its tableau, "
            f"got {method!r}"
        )
    if isinstance(method, Splitting):
        raise TypeError(f"method must not be a splitting method, got {method!r}")
    if isinstance(method, MagnusMethod) and method.brackets:
        raise TypeError(f"method must not combine brackets of fields, got {method!r}")
    order = method.order if order is None else check_integer("order", order, 1, MAX_ORDER)
    if order < 1:
        raise CertificationError(
            f"{method.name or 'the method'}: the coefficients satisfy no order conditions"
        )
    orders = [order]
    if method.layout.pair:
        if not method.embedded_order:
            raise CertificationError(
                f"{method.name or 'the method'}: the second weights satisfy no order conditions"
            )
        orders.append(method.embedded_order)
    packed = Packed(method.name, method.layout, method.coefficients, tuple(orders))
    digits = max(len(coefficient.text) for coefficient in packed.coefficients)
    bits = 64 * math.ceil((math.log2(10) * digits + _GUARD_BITS) / 64)
    try:
        with precision(bits):
            if any(coefficient.unit for coefficient in packed.coefficients):
                box = find_box(packed, bits, complete)
            else:
                check_rational(packed)
                box = Box(Decimal(0), tuple(packed.layout.names))
            beyond = find_beyond(packed, box)
    except CertificationError as error:
        if order > method.order:
            error.args = (f"the order is {method.order}, not {order}: {error}",)
        raise
    embedded = (orders[1], beyond[1]) if method.layout.pair else (None, None)
    return Certificate(method.name, order, embedded[0], bits, box, beyond[0], embedded[1])


def check(certificate: Certificate, method: Method) -> None:
    """Prove what a certificate, which is a hint only, says of a method; else CertificationError."""
    if not isinstance(certificate, Certificate):
        raise TypeError(f"certificate must be a Certificate, got {certificate!r}")
    if not isinstance(method, Method):
        raise TypeError(f"method must be a Method, got {method!r}")
    packed = fitting(certificate, method)
    with precision(certificate.bits):
        if certificate.radius == 0:
            check_rational(packed)
        else:
            box = certificate.box
            check_left_out(packed, box, prove_zero(packed, box), certificate.bits)
        check_beyond(packed, certificate)
