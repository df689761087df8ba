"""Known mistakes, recognised by the method that results when they are undone."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from operator import itemgetter

import numpy as np

from cg.construction.diagnosis.correction import corrections
from cg.construction.diagnosis.matching import CatalogueMatch, closest_match
from cg.construction.diagnosis.variants import order_on_vector_spaces, reversals, transposed
from cg.construction.layouts.points import MethodError
from cg.construction.methods.abscissae import wrong_abscissae
from cg.construction.methods.coefficients import MIN_ROUNDED_PLACES, Coefficient
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.support.quads import MissingQuadsError

_MIN_PLACES, _MAX_PLACES = 5, 12
"""Decimal places of truncated coefficients; fewer are taken as exact, more are harmless."""

_MAX_FRACTION_PLACES = 60  # of a fraction that may be a rounded decimal
_FULL_DOUBLE = 15  # significant digits of the shortest text of a double that wasn't truncated
_SINGLE = Fraction(1, 2**24)
_HARMLESS = 1e-13
_MAX_SHOWN = 5  # corrections


@dataclass(frozen=True)
class Finding:
    """A recognised mistake, or a known property of a method, as a sentence."""

    kind: str  # such as "reversed", "changed" or "digits"; "known" and "close" are no mistakes
    message: str

    @property
    def mistake(self) -> bool:
        """Whether the finding is a mistake."""
        return self.kind not in ("known", "close")

    def __str__(self) -> str:
        return self.message


def recognise_all(method: Method, c: Sequence[Coefficient] | None = None) -> Iterator[Finding]:
    """Yield the findings about a method; `c` are abscissae to compare its row sums with."""
    yield from (Finding("abscissae", text) for text in wrong_abscissae(method, c or []))
    yield from _equal_weights(method)
    place = _truncation_unit(method.coefficients)
    match = closest_match(method, within=Fraction(0) if place is None else place)
    order = method.exact_order
    if undone := [*_transposed(method, order), *_reversed(method, order)]:
        yield from undone  # such a method has no other mistake
        return
    known = [
        *_match_findings(method, match),
        *_decimals_as_fractions(method, order),
        *_truncated_digits(method, order, place),
    ]
    yield from known
    if not any(finding.mistake for finding in known):
        yield from _unlifted(method, order)
        if match is None and not method.approximate:
            with suppress(MissingQuadsError):
                yield from _corrected(method)


def _equal_weights(method: Method) -> Iterator[Finding]:
    second = method.exact_embedded
    if second is None:
        return
    apart = max(abs(x - y) for x, y in zip(method.exact[1], second, strict=True))
    if apart <= Fraction(_HARMLESS):
        yield Finding(
            "equal weights",
            f"the second weights equal the first up to {float(apart):.1g}: the difference of both "
            "results is zero up to rounding",
        )


def _match_findings(method: Method, match: CatalogueMatch | None) -> Iterator[Finding]:
    if match is None:
        return
    name = match.method.name
    flat = isinstance(match.method, MuntheKaas) and not isinstance(method, MuntheKaas)
    aside = ", a method of Munthe-Kaas for coordinates" if flat else ""
    if not match.changed:
        if method is not match.method:
            yield Finding("known", f"its coefficients are those of {name}{aside}")
        return
    labels = " and ".join(change[0] for change in match.changed)
    values = "; ".join(f"{_text(x)} here, {_text(y)} there" for _, x, y in match.changed)
    yield Finding("changed", f"it differs from {name}{aside} in {labels} only: {values}")


def _decimals_as_fractions(method: Method, order: int) -> Iterator[Finding]:
    """Recognise rounded numbers whose exact values were given, which have no uncertainty."""
    rounded = [_as_decimal(k) for k in method.coefficients]
    if method.approximate or all(k.unit == 0 for k in rounded):
        return
    full = method.with_coefficients(rounded).exact_order
    if full > order:
        yield Finding(
            "fractions",
            f"its coefficients are rounded numbers given as exact fractions: as decimals they give "
            f"order {full}. Pass texts of decimals, or floats such as .a and .b of a method",
        )


def _as_decimal(k: Coefficient) -> Coefficient:
    """Return a fraction with a denominator of a double or a decimal as a rounded number."""
    value, places = k.value, range(MIN_ROUNDED_PLACES, _MAX_FRACTION_PLACES)
    if k.unit or value.denominator == 1:
        return k
    if value.denominator > 2**MIN_ROUNDED_PLACES and Fraction(float(value)) == value:
        return Coefficient.read(float(value))
    decimal = next((n for n in places if 10**n % value.denominator == 0), None)
    return k if decimal is None else Coefficient.read(f"{value * 10**decimal}e-{decimal}")


def _truncated_digits(method: Method, order: int, place: Fraction | None) -> Iterator[Finding]:
    if place is not None:
        rounded = [
            Coefficient(k.value, k.text, max(k.unit, _unit(k, place))) for k in method.coefficients
        ]
        try:
            full = method.with_coefficients(rounded).exact_order
        except MethodError:
            return
        if full > order:
            places = f"{len(str(place.denominator)) - 1} places"
            precision = "single precision" if place < 0 else places
            yield Finding(
                "digits",
                f"its coefficients are truncated to {precision}: with all digits the order would "
                f"be {full}; now conditions are off by {method.largest_residual(full):.1g}, and "
                "errors can't fall below that",
            )
            return
    residual = method.largest_residual(order) if order and not method.approximate else 0.0
    if residual > _HARMLESS:
        yield Finding(
            "digits",
            "its coefficients have too few digits for double precision: conditions are off by "
            f"{residual:.1g}, and errors can't fall below that",
        )


def _truncation_unit(coefficients: Sequence[Coefficient]) -> Fraction | None:
    """Return the unit of truncated coefficients, negative for single precision, or None."""
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
    """Return the uncertainty of a truncated coefficient; zero if it is rational."""
    if _places(coefficient) is None:
        return Fraction(0)
    return place if place > 0 else -place * abs(coefficient.value)


def _places(coefficient: Coefficient) -> int | None:
    """Return the decimal places of a coefficient's shortest text; None if it is rational."""
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
            f"a is transposed: the transpose is{_name(turned)} explicit, of order "
            f"{turned.exact_order}",
        )


def _reversed(method: Method, order: int) -> Iterator[Finding]:
    orders = [(turned.exact_order, what, turned) for what, turned in reversals(method)]
    highest, what, turned = max(orders, key=itemgetter(0), default=(0, "", method))
    if highest > max(order, 1):
        are, they = ("is", "it gives") if what == "b" else ("are", "they give")
        yield Finding(
            "reversed",
            f"{what} {are} reversed: in the right order {they}{_name(turned) or ' a method'} of "
            f"order {highest}",
        )


def _corrected(method: Method) -> Iterator[Finding]:
    """Recognise one wrong coefficient of a method that the catalogue doesn't have."""
    found = corrections(method)
    if not found:
        return
    entries = " or ".join(
        f"{one.name} = {_text(one.given)} were {one.value.text}" for one in found[:_MAX_SHOWN]
    )
    more = f", or one of {len(found) - _MAX_SHOWN} others changed" * (len(found) > _MAX_SHOWN)
    conditions = found[0].conditions
    yield Finding(
        # a single condition may fail on purpose, but nothing solves two by accident
        "misprint" if conditions > 1 else "close",
        f"{conditions} violated conditions would hold, and the order be {found[0].order}, if only "
        f"{entries}{more}",
    )


def _unlifted(method: Method, order: int) -> Iterator[Finding]:
    if isinstance(method, MuntheKaas) or method.approximate:
        return
    flat = order_on_vector_spaces(method)
    if flat > order:
        yield Finding(
            "flat",
            f"it is a classical method: of order {flat} where flows commute, of order {order} on "
            "manifolds; cg.lift makes a method for manifolds of it, and cg.MuntheKaas uses its "
            "tableau on frames with brackets",
        )


def _name(method: Method) -> str:
    match = closest_match(method)
    return f" {match.method.name}," if match is not None and not match.changed else ""


def _text(coefficient: Coefficient) -> str:
    text = coefficient.text
    return repr(float(coefficient.value)) if "x" in text else text
