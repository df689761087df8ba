"""Coefficients of a method to any number of digits, as far as they are known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from ..method.coefficients import Coefficient
from ..method.method import Method
from ..structure.points import MethodError
from ..support.checks import check_integer
from ..support.quads import DECIMAL_DIGITS, to_decimal

if TYPE_CHECKING:
    from ..proofs import Certificate

__all__ = ["MAX_DIGITS", "Numbers", "known_digits", "numbers_of"]

MAX_DIGITS = 4000
"""More decimal digits of an integer Python doesn't write by default."""

_GUARD_DIGITS = 10


@dataclass(frozen=True)
class Numbers:
    """The coefficients of a method, known to as many digits as are to be written.

    Attributes
    ----------
    method : Method
        The method that they are of, with its coefficients as they are stored.
    values : tuple of Fraction
        Packed as its layout says; right to `digits` significant digits and some more.
    digits : int or None
        How many digits are to be written; None for those that are stored.
    """

    method: Method
    values: tuple[Fraction, ...]
    digits: int | None

    def decimal(self, value: Fraction) -> str:
        """Write a coefficient, or a sum of them, as a decimal number.

        Without a number of digits there are as many as tell any two binary128 numbers apart, and
        whatever reads them finds the same double as Python does.
        """
        if self.digits is not None:
            return to_decimal(value, self.digits)
        if float(value) == 0.0:  # below the range of doubles, which compilers refuse
            return "0"
        places = DECIMAL_DIGITS
        while float(text := to_decimal(value, places)) != float(value):
            places += DECIMAL_DIGITS
        return text

    def rounded(self, *, zeros: bool = False) -> Method:
        """Return the method with its coefficients written to so many digits.

        Those that are known exactly stay as they are.

        Parameters
        ----------
        zeros : bool, optional
            Keep zeros at the end of the others.

        Raises
        ------
        ValueError
            If with so few digits it isn't the method any more.
        """
        method, digits = self.method, self.digits
        if digits is None:
            return method
        texts = [
            to_decimal(value, digits, zeros=zeros) if given.unit else given.text
            for given, value in zip(method.coefficients, self.values, strict=True)
        ]
        try:
            return _with_texts(method, texts, digits, zeros)
        except MethodError as problem:
            name = method.name or "the method"
            raise ValueError(f"digits: {digits} are too few for {name}: {problem}") from None


def known_digits(method: Method) -> int | None:
    """Return how many significant digits of all coefficients are stored; None if they are exact.

    Those of binary128 numbers have 34 of them, doubles 16.

    Examples
    --------
    >>> import cg
    >>> known_digits(cg.methods["CG5d"]), known_digits(cg.methods["CG3"])
    (34, None)
    """
    third = getattr(method, "third_weights", None) or ()
    digits = [
        max(math.floor(math.log10(abs(given.value) / given.unit)) + 1, 1)
        for given in (*method.coefficients, *third)
        if given.unit and given.value
    ]
    return min(digits, default=None)


def numbers_of(method: Method, digits: int | None, certificate: Certificate | None) -> Numbers:
    """Return the coefficients of a method, from its certificate if more digits are asked for.

    Parameters
    ----------
    method : Method
    digits : int or None
        Significant digits; None for those that are stored.
    certificate : Certificate or None
        By default the one of the catalogue.

    Raises
    ------
    TypeError
        If an argument isn't of the type listed.
    ValueError
        If `digits` is out of range, or more than are known.
    CertificationError
        If the certificate isn't one of the method.
    """
    if not isinstance(method, Method):
        raise TypeError(f"method must be a Method, got {method!r}")
    if certificate is not None:
        from ..proofs import Certificate

        if not isinstance(certificate, Certificate):
            raise TypeError(f"certificate must be a Certificate, got {certificate!r}")
    stored = tuple(given.value for given in method.coefficients)
    if digits is None:
        return Numbers(method, stored, None)
    digits = check_integer("digits", digits, 1, MAX_DIGITS)
    known = known_digits(method)
    if known is None or digits <= known:
        return Numbers(method, stored, digits)
    from ..proofs import CertificationError, certificate_of, refined_digits

    try:
        if certificate is None:
            certificate = certificate_of(method)
            if not certificate.complete:
                raise CertificationError("some conditions are only shown to be small")
    except CertificationError as problem:
        raise ValueError(
            f"digits must be at most {known}, which are stored, since {problem}; got {digits}"
        ) from None
    wanted = min(digits + _GUARD_DIGITS, MAX_DIGITS)
    texts = refined_digits(method, certificate, wanted)
    return Numbers(method, tuple(map(Fraction, texts)), digits)


def _with_texts(method: Method, texts: Sequence[str], digits: int, zeros: bool) -> Method:
    """Return a method of the same kind with other coefficients."""
    fields: dict[str, Any] = {}
    if method.approximate:
        fields["nominal_order"] = method.nominal_order
        fields["nominal_residual"] = method.nominal_residual
    if (third := getattr(method, "third_weights", None)) is not None:
        fields["third"] = [_shortened(given, digits, zeros) for given in third]
    return method.with_coefficients(texts, **fields)


def _shortened(given: Coefficient, digits: int, zeros: bool) -> str:
    return to_decimal(given.value, digits, zeros=zeros) if given.unit else given.text
