"""Coefficients of a method rounded to a number of decimal digits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.method import Method
from cg.construction.points import MethodError
from cg.support.checks import check_instance, check_integer
from cg.support.parsing import visible
from cg.support.quads import DECIMAL_DIGITS, MAX_WRITTEN, to_decimal

if TYPE_CHECKING:
    from cg.construction.proofs import Certificate

_GUARD_DIGITS = 10  # beyond those that are written


@dataclass(frozen=True)
class Numbers:
    """The coefficients of a method in the order of its layout, and the digits to write, or None."""

    method: Method
    values: tuple[Fraction, ...]
    digits: int | None

    @property
    def heading(self) -> str:
        """A line such as ``CG4(3)b: order 4(3), 5 evaluations, 15 flows``, and the source."""
        name = visible(self.method.name) or "without name"
        return f"{name}: {self.method.description(complete=True)}\n{self.method.source}".strip()

    def decimal(self, value: Fraction) -> str:
        """Return a number in `digits` digits, by default enough of them to give the same double."""
        if self.digits is not None:
            return to_decimal(value, self.digits)
        if float(value) == 0.0:  # compilers reject numbers below the range of doubles
            return "0"
        places = DECIMAL_DIGITS
        while float(text := to_decimal(value, places)) != float(value):
            places += DECIMAL_DIGITS
        return text

    def rounded(self, *, zeros: bool = False) -> Method:
        """Return the method with coefficients rounded to `digits` digits, except rational ones."""
        method, digits = self.method, self.digits
        if digits is None:
            return method
        texts = [
            _rounded_text(coefficient, value, digits, zeros)
            for coefficient, value in zip(method.coefficients, self.values, strict=True)
        ]
        fields: dict[str, Any] = {}
        if method.approximate:
            fields["nominal_order"] = method.nominal_order
            fields["nominal_residual"] = method.nominal_residual
        if (third := method.third_weights) is not None:
            fields["third"] = [_rounded_text(w, w.value, digits, zeros) for w in third]
        try:
            return method.with_coefficients(texts, **fields)
        except MethodError as problem:
            name = method.name or "the method"
            raise ValueError(f"digits must be more for {name}, got {digits}: {problem}") from None


def known_digits(method: Method) -> int | None:
    """Return the smallest number of correct digits of coefficients; None if all are rational."""
    digits = [
        max(math.floor(math.log10(abs(coefficient.value) / coefficient.unit)) + 1, 1)
        for coefficient in (*method.coefficients, *(method.third_weights or ()))
        if coefficient.unit and coefficient.value
    ]
    return min(digits, default=None)


def numbers_of(method: Method, digits: int | None, certificate: Certificate | None) -> Numbers:
    """Return the coefficients of a method, from its certificate if it has too few digits."""
    check_instance("method", method, Method)
    if certificate is not None:
        from cg.construction.proofs import check

        check(certificate, method)
    stored = tuple(coefficient.value for coefficient in method.coefficients)
    if digits is None:
        return Numbers(method, stored, None)
    digits = check_integer("digits", digits, 1, MAX_WRITTEN)
    known = known_digits(method)
    if known is None or digits <= known:
        return Numbers(method, stored, digits)
    from cg.construction.proofs import CertificationError, certificate_of, refined_digits
    from cg.construction.proofs.digits import max_digits

    try:
        if certificate is None:
            certificate = certificate_of(method)
    except CertificationError as problem:
        raise ValueError(
            f"digits must be at most {known}, which are stored, since {problem}; got {digits}"
        ) from None
    most = max_digits(certificate)
    if digits > most:
        raise ValueError(
            f"digits must be at most {max(known, most)}, since some conditions are only shown to "
            f"be small; got {digits}"
        )
    texts = refined_digits(method, certificate, min(digits + _GUARD_DIGITS, most))
    return Numbers(method, tuple(map(Fraction, texts)), digits)


def _rounded_text(coefficient: Coefficient, value: Fraction, digits: int, zeros: bool) -> str:
    """Return a more precise value of a coefficient to `digits` digits; the same one unchanged."""
    same = not coefficient.unit and value == coefficient.value
    return coefficient.text if same else to_decimal(value, digits, zeros=zeros)
