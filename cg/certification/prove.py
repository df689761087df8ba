"""Proofs that a method has an order: `certify` finds them, `check` repeats them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from flint import arb, arb_mat, fmpq
from numpy.typing import NDArray
from scipy import linalg

from ..catalogue import resolve_method
from ..checks import check_integer
from ..coefficients import Coefficient
from ..conditions import HIGHEST_ORDER
from ..layout import Layout
from ..method import TOLERANCE_FACTOR, Method
from ..munthe_kaas import MuntheKaas
from ..precision import working_precision as precision
from ..quad import to_decimal
from .certificate import Beyond, Certificate, CertificationError
from .explain import (
    STRUCTURES,
    Structure,
    augment,
    find_identities,
    name_of,
    names_of_left_out,
    read_identity,
    read_left_out,
    without,
)
from .krawczyk import KrawczykTest, choose_free, krawczyk, numerical_rank, to_double
from .orthogonality import Condition, Known, conditions_of, find_relations, follow
from .parametric import RELATION_RADIUS
from .relations import Identity
from .systems import EquationSystem, exact_residuals, order_system
from .weights import Quantity, Weights
from .words import Word, condition_words, nodes, parse, reciprocal_density, text

__all__ = [
    "Packed",
    "box",
    "certify",
    "check",
    "check_rational",
    "fitting",
    "free_of",
    "precision",
    "prove_box",
    "start",
    "system_of",
]

_GUARD_BITS = 136  # beyond the stored places: conditioning, and room for a tight radius
_MOST_BITS = 1 << 14
_MOST_IDENTITIES = 100
_LEAST_BOUND = Fraction(1, 10**9)  # a smaller violation is a slip in the coefficients


@dataclass(frozen=True)
class Packed:
    """A method as a vector of coefficients.

    Attributes
    ----------
    layout : Layout
    coefficients : tuple of Coefficient
        Row by row; second weights last.
    """

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

    def balls(self) -> list[arb]:
        """Return balls, as small as the precision allows, that hold the values."""
        return [arb(fmpq(v.numerator, v.denominator)) for v in self.values]

    def zeros(self) -> list[frozenset[int]]:
        """Return at which stages each row of weights is exactly zero."""
        held = [k for k, coefficient in enumerate(self.coefficients) if coefficient.value == 0]
        rows = map(self.layout.row, range(self.layout.stages, len(self.layout.ends)))
        return [frozenset(self.layout.stage_of[k].item() for k in held if k in row) for row in rows]


def certify(method: Method | str, order: int | None = None) -> Certificate:
    """Prove the order of a method.

    Shows by Krawczyk's test in ball arithmetic that close to the stored coefficients there
    is an exact solution of the order conditions, and that one of the next order is
    violated. Rational methods are proved in rational arithmetic.

    Parameters
    ----------
    method : Method or str
        A name is looked up in the catalogue. Second weights of a pair are proved as well.
    order : int, optional
        By default the order of the method. It must be the order exactly.

    Returns
    -------
    Certificate

    Raises
    ------
    TypeError
        If `method` is neither a name nor a method, or `order` isn't an integer.
    ValueError
        If no method has that name, or `order` is out of range.
    CertificationError
        If there is no proof; with the quantities that tell why.

    Examples
    --------
    >>> certify("CG3").order
    3
    """
    method = resolve_method(method)
    if isinstance(method, MuntheKaas):
        raise TypeError(f"method must be a Tableau or CommutatorFree, got {method!r}")
    order = method.order if order is None else check_integer("order", order, 1, HIGHEST_ORDER)
    if order < 1:
        raise CertificationError(
            f"{method.name or 'the method'}: the coefficients satisfy no order conditions"
        )
    pair = method.layout.pair
    packed = Packed.of(method)
    embedded_order = method.embedded_order if pair else None
    if pair and not embedded_order:
        raise CertificationError(
            f"{method.name or 'the method'}: the second weights satisfy no order conditions"
        )
    digits = max(len(coefficient.text) for coefficient in packed.coefficients)
    draft = Certificate(
        name=method.name,
        order=order,
        embedded_order=embedded_order,
        radius="0",
        bits=64 * math.ceil((math.log2(10) * digits + _GUARD_BITS) / 64),
        identities=(),
        fixed=tuple(packed.layout.names),
        beyond=Beyond("[]", "0"),
        embedded_beyond=None,
    )
    with precision(draft.bits):
        if any(coefficient.unit for coefficient in packed.coefficients):
            draft = _find_zero(packed, draft)
        else:
            check_rational(packed, draft)
        return _find_beyond(packed, draft)


def check(certificate: Certificate, method: Method) -> None:
    """Prove what a certificate says from scratch.

    Parameters
    ----------
    certificate : Certificate
        Nothing in it is believed.
    method : Method

    Raises
    ------
    CertificationError
        If it doesn't belong to the method, or if it can't be proved.
    """
    if not isinstance(certificate, Certificate):
        raise TypeError(f"certificate must be a Certificate, got {certificate!r}")
    if not isinstance(method, Method):
        raise TypeError(f"method must be a Method, got {method!r}")
    packed = fitting(certificate, method)
    with precision(certificate.bits):
        if Fraction(certificate.radius) == 0:
            if len(certificate.fixed) != packed.layout.size:
                raise CertificationError("a radius of 0 needs all coefficients fixed")
            if certificate.identities:
                raise CertificationError("a radius of 0 needs no identities")
            check_rational(packed, certificate)
        else:
            prove_box(packed, certificate)
        _check_beyond(packed, certificate)


def fitting(certificate: Certificate, method: Method) -> Packed:
    """Return the method as a certificate sees it; CertificationError if it isn't the one meant."""
    pair = certificate.embedded_order is not None
    faults = []
    if certificate.name != method.name:
        faults.append(f"it is for {certificate.name!r}, not for {method.name!r}")
    if pair != method.layout.pair:
        faults.append("second weights must be proved, and those of pairs only")
    orders = _orders(certificate)
    if not all(type(order) is int and 1 <= order <= HIGHEST_ORDER for order in orders):
        faults.append(f"orders must be between 1 and {HIGHEST_ORDER}")
    if not 53 <= certificate.bits <= _MOST_BITS:
        faults.append(f"bits must be between 53 and {_MOST_BITS}, got {certificate.bits}")
    if len(certificate.identities) > _MOST_IDENTITIES:
        faults.append(f"there may be at most {_MOST_IDENTITIES} identities")
    if faults:
        raise CertificationError(f"the certificate doesn't fit: {'; '.join(faults)}")
    packed = Packed.of(method)
    names = _names(packed, certificate)
    held = set(certificate.fixed)
    if len(held) != len(certificate.fixed) or not held.issubset(names):
        raise CertificationError("the fixed coefficients must be distinct ones of the method")
    for name, coefficient in zip(names, packed.coefficients, strict=False):
        if coefficient.value == 0 and name not in held:
            raise CertificationError(f"{name} is exactly zero, so it must be fixed")
    return packed


def system_of(packed: Packed, certificate: Certificate) -> EquationSystem:
    """Return the equations of a certificate."""
    if not certificate.identities:
        return order_system(packed.layout, certificate.order, certificate.embedded_order)
    left_out, name = _left_out(certificate)
    if left_out:
        structure = _structure(packed, certificate, name)
        more = structure.equations() if structure else []
        try:
            return without(packed.layout, _orders(certificate), left_out, more)
        except ValueError as error:
            raise CertificationError(str(error)) from None
    if Fraction(certificate.radius) >= Fraction(RELATION_RADIUS):
        raise CertificationError("the radius is too large for the relations of identities")
    try:
        identities = _identities(certificate)
        return augment(packed.layout, _orders(certificate), identities, packed.zeros())
    except (ValueError, ArithmeticError) as error:
        raise CertificationError(str(error)) from None


def _structure(packed: Packed, certificate: Certificate, name: str) -> Structure | None:
    """Return the structure of a method; CertificationError if it hasn't that one."""
    if not name:
        return None
    found: Structure = STRUCTURES[name](packed.layout, _orders(certificate), packed.values)
    if not found.satisfied():
        raise CertificationError(f"{certificate.name}: it has no {name} of this order")
    return found


def _left_out(certificate: Certificate) -> tuple[list[Condition], str]:
    """Return the conditions that follow by orthogonality, and the name of a structure."""
    try:
        return read_left_out(certificate.identities)
    except ValueError as error:
        raise CertificationError(str(error)) from None


def _identities(certificate: Certificate) -> list[Identity]:
    if _left_out(certificate)[0]:
        return []
    try:
        return [read_identity(name) for name in certificate.identities]
    except (ValueError, ZeroDivisionError) as error:
        raise CertificationError(str(error)) from None


def _names(packed: Packed, certificate: Certificate) -> list[str]:
    """Return the names of all unknowns: coefficients, and parameters of identities."""
    count = sum(len(identity.parameters) for identity in _identities(certificate))
    return [*packed.layout.names, *(f"parameter_{k}" for k in range(1, count + 1))]


def start(packed: Packed, certificate: Certificate) -> list[arb]:
    """Return the stored coefficients, and the parameters of identities, as balls."""
    parameters = [p for identity in _identities(certificate) for p in identity.parameters]
    return packed.balls() + [arb(fmpq(p.numerator, p.denominator)) for p in parameters]


def _orders(certificate: Certificate) -> list[int]:
    embedded = certificate.embedded_order
    return [certificate.order] if embedded is None else [certificate.order, embedded]


def free_of(packed: Packed, certificate: Certificate) -> list[int]:
    """Return the indices of the coefficients that aren't fixed."""
    held = set(certificate.fixed)
    return [k for k, name in enumerate(_names(packed, certificate)) if name not in held]


def prove_box(packed: Packed, certificate: Certificate) -> None:
    """Prove the zero in the box of a certificate; CertificationError if that fails."""
    system = system_of(packed, certificate)
    free = free_of(packed, certificate)
    if len(free) != len(system.equations):
        raise CertificationError(
            "there must be as many free coefficients as equations",
            free=len(free),
            equations=len(system.equations),
        )
    y = start(packed, certificate)
    conditions = order_system(packed.layout, certificate.order, certificate.embedded_order)
    values, jacobian = conditions.linearise(y)
    _check_places(packed, conditions, values, jacobian)
    attempt = krawczyk(system, y, free, arb(certificate.radius))
    if not attempt.proved:
        raise CertificationError(f"{certificate.name}: no zero is proved", **_quantities(attempt))
    _check_left_out(packed, certificate)


def _check_left_out(packed: Packed, certificate: Certificate) -> None:
    """Prove that the conditions that are left out follow from the others."""
    left_out, name = _left_out(certificate)
    structure = _structure(packed, certificate, name)
    known = list(structure.relations()) if structure else []
    around = box(packed, certificate)
    if left_out and not follow(packed.layout, _orders(certificate), around, left_out, known):
        raise CertificationError(
            f"{certificate.name}: that conditions follow from others is not proved",
            left_out=len(left_out),
        )


def _quantities(attempt: KrawczykTest) -> dict[str, float]:
    return {
        "radius": float(attempt.radius),
        "ratio": attempt.ratio,
        "correction": attempt.correction,
        "contraction": attempt.contraction,
    }


def _check_places(
    packed: Packed, system: EquationSystem, values: Sequence[arb], jacobian: arb_mat
) -> None:
    """Refuse coefficients that are further off than their last places can explain.

    Otherwise a solution close to wrong coefficients would pass as theirs.
    """
    units = np.array([float(coefficient.unit) for coefficient in packed.coefficients])
    allowed = TOLERANCE_FACTOR * (np.abs(to_double(jacobian)) @ units)
    for equation, value, bound in zip(system.equations, values, allowed, strict=True):
        if not abs(value) <= float(bound):
            raise CertificationError(
                f"the condition of {equation.label} is violated by more than the last places "
                "of the coefficients can explain",
                residual=float(abs(value).upper()),
                allowed=float(bound),
            )


def _find_zero(packed: Packed, draft: Certificate) -> Certificate:
    y = packed.balls()
    system = order_system(packed.layout, draft.order, draft.embedded_order)
    values, jacobian = system.linearise(y)
    _check_places(packed, system, values, jacobian)
    found = _try(packed, draft, system, to_double(jacobian))
    if isinstance(found, Certificate):
        return found
    tried: list[str] = []
    if packed.layout.rows is None:
        extended, relations = _orthogonal(packed, draft, to_double(jacobian))
        tried.append(f"orthogonality, by which {relations} conditions follow")
        if extended is not None:
            system = system_of(packed, extended)
            again = _try(packed, extended, system, to_double(system.linearise(y)[1]))
            if isinstance(again, Certificate):
                _check_left_out(packed, again)
                return again
            found = again
    for identities in find_identities(packed.layout, y, packed.zeros()):
        names = tuple(map(name_of, identities))
        tried.append(" and ".join(identity.heading for identity in identities))
        extended = replace(draft, identities=names)
        try:
            augmented = augment(packed.layout, _orders(draft), identities, packed.zeros())
        except ArithmeticError:
            continue
        jacobian = augmented.linearise(start(packed, extended))[1]
        again = _try(packed, extended, augmented, to_double(jacobian))
        if isinstance(again, Certificate):
            return again
    message = f"{draft.name}: no zero of the conditions of order {draft.order} is proved"
    if found["rank"] < found["conditions"]:
        message += ", their derivatives are dependent and no known identities explain that"
    raise CertificationError(message, **found, tried="; ".join(tried) or "no identities")


def _orthogonal(
    packed: Packed, draft: Certificate, jacobian: NDArray[np.float64]
) -> tuple[Certificate | None, int]:
    """Return a draft that leaves out what follows by orthogonality, and how much does.

    None if the conditions that are left would still depend on each other.
    """
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    orders = _orders(draft)
    every = {name: make(packed.layout, orders, packed.values) for name, make in STRUCTURES.items()}
    name = next((name for name, one in every.items() if one.satisfied()), "")
    known: list[Known] = []
    along = jacobian[:, nonzero]
    if name:
        known = list(every[name].relations())
        system = EquationSystem(packed.layout, tuple(every[name].equations()))
        held = to_double(system.linearise(packed.balls())[1])[:, nonzero]
        along = along @ linalg.null_space(held)
    dependent = len(jacobian) - numerical_rank(along)[0]
    relations = find_relations(packed.layout, orders, packed.balls(), dependent, known)
    if len(relations) < max(dependent, 1):
        return None, len(relations)
    pivots = linalg.qr(relations, mode="r", pivoting=True)[1][:dependent]
    conditions = conditions_of(orders)
    left_out = [conditions[k] for k in sorted(map(int, pivots))]
    return replace(draft, identities=names_of_left_out(left_out, name)), dependent


def _try(
    packed: Packed, draft: Certificate, system: EquationSystem, jacobian: NDArray[np.float64]
) -> Certificate | dict[str, float]:
    """Return the certificate with the zero proved, or the quantities that tell why not."""
    names = _names(packed, draft)
    size = len(system.equations)
    parameters = list(range(packed.layout.size, system.unknowns))
    rough = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.unit]
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    found: dict[str, float] = {}
    for movable in (rough, nonzero):  # better to hold all that are exact, not zeros only
        candidates = movable + parameters
        rank, singular = numerical_rank(jacobian[:, candidates])
        found = {"conditions": size, "rank": rank, "smallest_singular_value": float(singular[-1])}
        found["largest_singular_value"] = float(singular[0])
        if rank < size:
            continue
        free = choose_free(jacobian, candidates)
        attempt = krawczyk(system, start(packed, draft), free)
        found |= _quantities(attempt)
        if attempt.proved:
            held = tuple(name for k, name in enumerate(names) if k not in set(free))
            return replace(draft, radius=f"{float(attempt.radius):.1e}", fixed=held)
    return found


def check_rational(packed: Packed, certificate: Certificate) -> None:
    """Prove that no condition has a residual; CertificationError, which names it, if one has."""
    for r, order in enumerate(_orders(certificate), packed.layout.stages):
        words = condition_words(order)
        for word, residual in zip(
            words, exact_residuals(packed.layout, packed.values, words, r), strict=True
        ):
            if residual != 0:
                raise CertificationError(
                    f"{certificate.name}: the condition of {text(word)} is violated",
                    residual=float(residual),
                )


def box(packed: Packed, certificate: Certificate) -> list[arb]:
    """Return balls that hold the exact solution, and the parameters of identities."""
    y = start(packed, certificate)
    radius = arb(certificate.radius).upper()
    for k in free_of(packed, certificate):
        y[k] = y[k] + arb(0, radius)
    return y


def _find_beyond(packed: Packed, draft: Certificate) -> Certificate:
    found: list[Beyond] = []
    for r, order in enumerate(_orders(draft)):
        words = [w for w in condition_words(order + 1) if nodes(w) == order + 1]
        bounds = _bounds(packed, draft, words, packed.layout.stages + r)
        best = max(range(len(words)), key=lambda k: bounds[k])
        if bounds[best] < _LEAST_BOUND:
            raise CertificationError(
                f"{draft.name}: no condition of order {order + 1} is violated by much, "
                f"so order {order} isn't the highest, or coefficients are wrong",
                largest_bound=float(bounds[best]),
            )
        found.append(Beyond(text(words[best]), _rounded_down(bounds[best])))
    second = found[1] if len(found) > 1 else None
    return replace(draft, beyond=found[0], embedded_beyond=second)


def _check_beyond(packed: Packed, certificate: Certificate) -> None:
    claims = [certificate.beyond, certificate.embedded_beyond]
    for r, (order, claim) in enumerate(zip(_orders(certificate), claims, strict=False)):
        if claim is None:
            raise CertificationError("second weights need a condition that they violate")
        try:
            word = parse(claim.tree)
        except ValueError as error:
            raise CertificationError(str(error)) from None
        if nodes(word) != order + 1:
            raise CertificationError(
                f"{claim.tree} must have {order + 2} nodes to tell of order {order + 1}"
            )
        bound = _bounds(packed, certificate, [word], packed.layout.stages + r)[0]
        if not bound >= Fraction(claim.bound) >= _LEAST_BOUND:
            raise CertificationError(
                f"{certificate.name}: the condition of {claim.tree} isn't violated by as much as "
                f"{claim.bound}",
                bound=float(bound),
            )


def _bounds(
    packed: Packed, certificate: Certificate, words: Sequence[Word], row: int
) -> list[Fraction]:
    """Return lower bounds of the residuals' magnitudes in the box."""
    weights = Weights(packed.layout, [Quantity(row, word) for word in words])
    bounds = []
    for value, word in zip(weights.evaluate(box(packed, certificate)), words, strict=True):
        target = reciprocal_density(word)
        lower = (value - arb(fmpq(target.numerator, target.denominator))).abs_lower()
        mantissa, exponent = lower.man_exp()
        bounds.append(int(mantissa) * Fraction(2) ** int(exponent))
    return bounds


def _rounded_down(value: Fraction) -> str:
    """Write a positive number with three digits, no more than it is."""
    unit = Fraction(10) ** (math.floor(math.log10(value)) - 2)
    return to_decimal(value // unit * unit, 4)
