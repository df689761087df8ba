"""Coefficients to any number of digits, by iteration in the box of a certificate."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from cg.construction.catalogue import resolve_method
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.proofs.certificate import Certificate, CertificationError
from cg.construction.proofs.packed import certificate_of, fitting
from cg.construction.proofs.zero import bits_of, check_left_out, check_rational, prove_zero, zero_of
from cg.support import flint
from cg.support.checks import check_flag, check_instance, check_integer
from cg.support.quads import MAX_WRITTEN, exact_midpoint, to_decimal, working_precision

_GUARD_DIGITS = 15  # beyond those that are asked for, twice and four times as many if need be


def refined_digits(method: Method, certificate: Certificate, digits: int) -> list[str]:
    """Return the coefficients of the exact solution that a certificate proves, as texts.

    The zero is proved again; that left-out conditions follow from others only if the certificate
    isn't the catalogue's. Fixed coefficients are as stored. All `digits` of the others are right,
    the last one rounded. CertificationError if the certificate proves fewer digits.
    """
    digits = check_integer("digits", digits, 1, MAX_WRITTEN)
    check_instance("certificate", certificate, Certificate)
    packed = fitting(certificate, method)
    if digits > max_digits(certificate):
        raise CertificationError(
            f"{certificate.name}: some conditions are only shown to be small, so that digits must "
            f"be at most {max_digits(certificate)}, got {digits}"
        )
    texts = [coefficient.text for coefficient in method.coefficients]
    movable = packed.movable(certificate)
    moves = packed.spread([float(name not in certificate.fixed) for name in packed.names])
    changed = [k for k, moved in enumerate(moves) if moved]
    with working_precision(certificate.bits):
        if certificate.radius == 0 or not movable:
            check_rational(packed)
            return texts
        test, stored = prove_zero(packed, certificate), None
        with suppress(CertificationError):
            stored = certificate_of(method)
        if certificate != stored:
            check_left_out(packed, certificate, test, certificate.bits)
    for guard in (_GUARD_DIGITS, 2 * _GUARD_DIGITS, 4 * _GUARD_DIGITS):
        places = max(digits, -certificate.radius.adjusted()) + guard
        with working_precision(bits_of(places, certificate.bits)):
            zero = packed.spread(zero_of(packed, certificate, test, places))
            rounded = {k: rounded_text(zero[k], digits) for k in changed}
        if all(rounded.values()):
            return [rounded.get(k) or text for k, text in enumerate(texts)]
    raise CertificationError(f"{certificate.name}: the last digits couldn't be decided")


def max_digits(certificate: Certificate) -> int:
    """Return how many digits a certificate proves.

    With a bound on residuals these are half of its digits: residuals may be quadratic in the
    distance from a solution of all conditions.
    """
    bound = certificate.bound
    return MAX_WRITTEN if bound is None else min(MAX_WRITTEN, -bound.adjusted() // 2)


def digits(
    method: Method | str,
    digits: int,
    *,
    certificate: Certificate | None = None,
    embedded: bool = False,
) -> Any:
    """Return the coefficients of the exact method, to any number of digits.

    Parameters
    ----------
    method
        A name is looked up in the catalogue.
    digits
        Significant digits of the coefficients that the certificate doesn't hold fixed.
    certificate
        By default the one of the catalogue; see `cg.certify`.
    embedded
        With a tableau, return the second weights in place of b.

    Returns
    -------
    a, b
        For a tableau: strings. All digits are right. Fixed coefficients are as they are stored.
    weights
        For a commutator-free method: of each point, by stage. For a Magnus method each node that
        isn't zero comes first.
    drifts, kicks
        For a splitting method: strings.
    rows
        For a Magnus method with brackets: nodes, both sides of each bracket, weights.

    Raises
    ------
    CertificationError
        If there is no certificate, or it can't be proved.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.digits("CG4b", 40)[1][0]
    '0.1733158389077557335176411113901044187491'
    """
    method = resolve_method(method)
    if check_flag("embedded", embedded) and method.embedded is None:
        raise ValueError(f"embedded must be False without second weights, got {method!r}")
    if certificate is None:
        certificate = certificate_of(method)
    texts = refined_digits(method, certificate, digits)
    if isinstance(method, Splitting):
        return texts[::2], texts[1::2]
    if isinstance(method, MagnusMethod) and method.brackets:
        return method.filled(texts, "0")
    if method.layout.rows is None:
        return method.layout.point_weights(texts)
    rows = [[str(entry) for entry in row] for row in method.layout.full_rows(texts)]
    return rows[: method.stages], rows[method.stages + embedded]


def rounded_text(ball: flint.arb, digits: int) -> str | None:
    """Return a ball's digits; None if both of its ends don't round to the same ones."""
    ends = {to_decimal(exact_midpoint(end), digits) for end in (ball.lower(), ball.upper())}
    return ends.pop() if len(ends) == 1 else None
