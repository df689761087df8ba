"""Known mistakes, each recognised by the method that it was made of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np

from ...method.coefficients import Coefficient
from ...method.method import Method
from ...method.munthe_kaas import MuntheKaas
from ...structure.points import MethodError
from .findings import Finding
from .likeness import Likeness, likeness
from .variants import order_on_vector_spaces, reversals, transposed

__all__ = ["find_all"]

_MIN_PLACES, _MAX_PLACES = 5, 12
"""Of coefficients that were cut short: fewer are meant as they are, and more are harmless."""

_FULL_DOUBLE = 15  # significant digits of the shortest text of a double that wasn't cut short
_SINGLE = Fraction(1, 2**24)
_HARMLESS = 1e-13
_SLIP = ("CG4a", "a_5,4", Fraction("-1.1092979392113565"))


def find_all(method: Method, c: Sequence[Coefficient] | None = None) -> Iterator[Finding]:
    """Return what is known of a method; `c` are abscissae that it came with."""
    yield from _abscissae(method, c)
    yield from _equal_weights(method)
    place = _short_unit(method.coefficients)
    like = likeness(method, within=Fraction(0) if place is None else place)
    order = method.exact_order
    turned = [*_transposed(method, order), *_reversed(method, order)]
    # the other way round it is a method as it was meant: nothing else is to blame
    known = [] if turned else [*_known(method, like), *_digits(method, order, place)]
    yield from turned
    yield from known
    if not turned and not any(finding.mistake for finding in known):
        yield from _flat(method, order)


def _abscissae(method: Method, c: Sequence[Coefficient] | None) -> Iterator[Finding]:
    if c is None:
        return
    for i, (given, row) in enumerate(zip(c, method.exact[0], strict=True), 1):
        total = sum(row, Fraction(0))
        # rounded entries leave their sum off by as much as each
        allowed = given.unit + sum((k.unit for k in method.coefficients), Fraction(0))
        if abs(given.value - total) > allowed:
            yield Finding(
                "abscissae",
                f"row {i} of a sums to {_short(total)}, not to c_{i} = {given.text}: "
                f"off by {float(total - given.value):.3g}",
            )


def _equal_weights(method: Method) -> Iterator[Finding]:
    second = method.exact_embedded
    if second is None:
        return
    apart = max(abs(x - y) for x, y in zip(method.exact[1], second, strict=True))
    if apart <= Fraction(_HARMLESS):
        yield Finding(
            "equal weights",
            f"the second weights equal the first up to {float(apart):.1g}: the difference of both "
            "results estimates no error",
        )


def _known(method: Method, like: Likeness | None) -> Iterator[Finding]:
    if like is None:
        return
    name = like.method.name
    flat = isinstance(like.method, MuntheKaas) and not isinstance(method, MuntheKaas)
    aside = ", a method of Munthe-Kaas for coordinates" if flat else ""
    if not like.changed:
        if method is not like.method:
            yield Finding("known", f"its coefficients are those of {name}{aside}")
        return
    if [(name, *change[:1]) for change in like.changed] == [_SLIP[:2]]:
        here = like.changed[0][1]
        if abs(here.value - _SLIP[2]) <= here.unit:
            yield Finding(
                "slip",
                "it is CG4a with a misprint that went from code to code: a_5,4 = "
                f"{_text(here)} has one digit wrong, where the paper has "
                "-1.1092979392113465; its own c_5 tells which is right",
            )
            return
    labels = " and ".join(change[0] for change in like.changed)
    values = "; ".join(f"{_text(x)} here, {_text(y)} there" for _, x, y in like.changed)
    yield Finding("changed", f"it differs from {name}{aside} in {labels} only: {values}")


def _digits(method: Method, order: int, place: Fraction | None) -> list[Finding]:
    if place is not None:
        rounded = [
            Coefficient(k.value, k.text, max(k.unit, _unit(k, place))) for k in method.coefficients
        ]
        try:
            meant = method.with_coefficients(rounded).exact_order
        except MethodError:
            return []
        if meant > order:
            return [
                Finding(
                    "digits",
                    f"its coefficients are cut short, to {_precision(place)}: with all digits it "
                    f"would have order {meant}, as it is conditions are off by "
                    f"{method.largest_residual(meant):.1g}, and errors don't fall below that",
                )
            ]
    if order and not method.approximate:
        residual = method.largest_residual(order)
        if residual > _HARMLESS:
            return [
                Finding(
                    "digits",
                    f"its coefficients have too few digits for double precision: conditions are "
                    f"off by {residual:.1g}, and errors don't fall below that",
                )
            ]
    return []


def _short_unit(coefficients: Sequence[Coefficient]) -> Fraction | None:
    """Return the last place of coefficients that were cut short; negative for single precision.

    None if they weren't.
    """
    places = [p for p in map(_places, coefficients) if p is not None]
    if not places:
        return None
    if _MIN_PLACES <= max(places) <= _MAX_PLACES:
        return Fraction(1, 10 ** max(places))
    values = [float(k.value) for k in coefficients if k.value != 0]
    with np.errstate(over="ignore"):
        single = all(float(np.float32(v)) == v for v in values)
    return -_SINGLE if single else None


def _unit(coefficient: Coefficient, place: Fraction) -> Fraction:
    """Return what a coefficient that isn't an integer or a quotient is off by."""
    if _places(coefficient) is None:
        return Fraction(0)
    return place if place > 0 else -place * abs(coefficient.value)


def _precision(place: Fraction) -> str:
    return "single precision" if place < 0 else f"{len(str(place.denominator)) - 1} places"


def _places(coefficient: Coefficient) -> int | None:
    """Return the decimal places of a coefficient's shortest text; None of a quotient."""
    text = coefficient.text
    if "x" in text:
        text = repr(float(coefficient.value))
        digits = text.split("e")[0].replace(".", "").replace("-", "").lstrip("0")
        if len(digits) >= _FULL_DOUBLE:
            return _FULL_DOUBLE
    if "." not in text and "e" not in text.lower():
        return None
    number, _, exponent = text.lower().partition("e")
    return len(number.partition(".")[2]) - int(exponent or 0)


def _transposed(method: Method, order: int) -> Iterator[Finding]:
    turned = transposed(method)
    if turned is not None and turned.exact_order > order:
        yield Finding(
            "transposed",
            f"a is transposed: with rows for columns it is{_name(turned)} explicit, of order "
            f"{turned.exact_order}",
        )


def _reversed(method: Method, order: int) -> Iterator[Finding]:
    best: tuple[int, str, Method] | None = None
    for what, turned in reversals(method):
        if turned.exact_order > max(order, best[0] if best else 1):
            best = turned.exact_order, what, turned
    if best is not None:
        found, what, turned = best
        are = "is" if what == "b" else "are"
        yield Finding(
            "reversed",
            f"{what} {are} in reverse: the other way round it is{_name(turned)} of order {found}",
        )


def _flat(method: Method, order: int) -> Iterator[Finding]:
    if isinstance(method, MuntheKaas) or method.approximate:
        return
    flat = order_on_vector_spaces(method)
    if flat > order:
        yield Finding(
            "flat",
            f"it is a method for vector spaces as it stands: of order {flat} where flows commute, "
            f"of order {order} on manifolds; cg.lift brings a flat tableau to manifolds, "
            "cg.MuntheKaas uses one where brackets are at hand",
        )


def _name(method: Method) -> str:
    like = likeness(method)
    return f" {like.method.name}," if like is not None and not like.changed else ""


def _text(coefficient: Coefficient) -> str:
    text = coefficient.text
    return repr(float(coefficient.value)) if "x" in text else text


def _short(value: Fraction) -> str:
    # Python may refuse to write a longer one
    text = str(value) if value.denominator.bit_length() <= 64 else ""
    return text if 0 < len(text) <= 12 else f"{float(value):.16g}"
