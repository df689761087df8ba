"""Proofs that a method has an order: `certify` finds them, `check` repeats them.

The order isn't higher if a condition of the next one is violated: the lower bound of ``|Φ(w) -
1/γ(w)|`` over all coefficients in the box, in ball arithmetic, must be at least `_MIN_BOUND`. So it
holds for the exact solution in the box, wherever that is.

To prove a zero, coefficients to hold, conditions to leave out and a radius are chosen. The pivots
of a QR factorisation of the Jacobian choose the coefficients that move, the pivots of the matrix of
relations between residuals choose the conditions to leave out: both keep the remaining square
Jacobian well conditioned, on which the radius of Krawczyk's test depends. Nothing here is trusted:
`zero` proves the zero again.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from decimal import ROUND_FLOOR, Context, Decimal
from fractions import Fraction

import numpy as np
from scipy import linalg

from cg.construction.catalogue import resolve_method
from cg.construction.conditions import MAX_ORDER
from cg.construction.conditions.exact import Condition, Word
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.method import Method
from cg.construction.proofs.certificate import (
    Box,
    Certificate,
    CertificationError,
    ViolatedCondition,
)
from cg.construction.proofs.dependent.orthogonality import find_relations
from cg.construction.proofs.krawczyk import (
    KrawczykTest,
    choose_movable,
    doubles,
    krawczyk,
    numerical_rank,
)
from cg.construction.proofs.packed import Linearised, PackedMethod, PackedWeights, fitting, pack
from cg.construction.proofs.zero import (
    check_left_out,
    check_places,
    check_rational,
    max_residual,
    prove_zero,
)
from cg.support.checks import check_flag, check_instance, check_integer
from cg.support.quads import exact_midpoint, working_precision

SMALL_PLACES = 300
"""Conditions that are only shown to be small are evaluated to this many places."""

_GUARD_BITS = 136  # beyond the stored places: conditioning, and room for a tight radius

_MIN_BOUND = Fraction(1, 10**9)  # a smaller violation is a slip in the coefficients
_ROUNDED_DOWN = Context(prec=3, rounding=ROUND_FLOOR)


def find_box(packed: PackedMethod, bits: int, complete: bool = False) -> Box:
    """Return a box in which the conditions have a zero that is proved, or raise.

    Unless `complete`, conditions that depend on others for unknown reasons are shown to be small.
    """
    at_point = packed.system().linearise(packed.balls())
    check_places(packed, *at_point)
    jacobian = doubles(at_point[1].tolist())
    proof, measures = _prove_without([], packed, at_point)
    if proof is not None:
        return proof[0]
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    dependent = len(jacobian) - numerical_rank(jacobian[:, nonzero])[0]
    message = f"{packed.name}: no zero of the conditions of order {packed.orders[0]} is proved"
    if dependent:
        relations = np.array([])
        if isinstance(packed, PackedWeights):
            relations = find_relations(packed.layout, packed.orders, packed.balls(), dependent)
        explained = len(relations) == dependent
        matrix = relations if explained else jacobian[:, nonzero].T
        pivots = linalg.qr(matrix, mode="r", pivoting=True)[1]
        message += (
            f", their derivatives are dependent and orthogonality explains {len(relations)} of "
            f"{dependent} dependences"
        )
        if explained or not complete:
            left_out = pivots[:dependent] if explained else pivots[-dependent:]
            proof, measures = _prove_without(left_out.tolist(), packed, at_point)
        if proof is not None:
            box, test = proof
            if explained:
                check_left_out(packed, box, test, bits)
                return box
            # the box has a bound of the conditions that are left out, a power of ten
            largest = float(max_residual(packed, box, test, SMALL_PLACES, bits))
            exponent = max(math.ceil(math.log10(max(largest, 1e-307))), -SMALL_PLACES)
            return replace(box, bound=Decimal((0, (1,), exponent)))
    raise CertificationError(message, **measures)


def _prove_without(
    left_out: Sequence[int], packed: PackedMethod, at_point: Linearised
) -> tuple[tuple[Box, KrawczykTest] | None, dict[str, float]]:
    """Return a box with a zero of the other conditions and its test, or None, and quantities.

    The quantities tell why there is no proof. Nothing is proved yet of the conditions left out.
    """
    omitted = [packed.conditions[k] for k in sorted(left_out)]
    system = packed.system(omitted)
    at_point = packed.without(at_point, omitted)
    jacobian = doubles(at_point[1].tolist())
    rough = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.unit]
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    for candidates in (rough, nonzero):  # better to hold all that are exact, not zeros only
        rank, singular = numerical_rank(jacobian[:, candidates])
        measures: dict[str, float] = {
            "conditions": len(jacobian),
            "rank": rank,
            "smallest_singular_value": float(singular[-1]),
            "largest_singular_value": float(singular[0]),
        }
        if rank < len(jacobian):
            continue
        # exact coefficients are fixed if possible
        preferences = np.where([c.unit == 0 for c in packed.coefficients], 1e-6, 1.0)
        movable = choose_movable(jacobian * preferences, candidates)
        test = krawczyk(system, packed.balls(), movable, at_point=at_point)
        measures |= test.quantities
        if test.proved:
            rest = sorted(set(range(len(packed.names))) - set(movable))
            fixed = tuple(packed.names[k] for k in rest)
            radius = Decimal(f"{float(test.radius):.1e}")
            return (Box(radius, fixed, tuple(omitted)), test), measures
    return None, measures


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
    order = method.order if order is None else check_integer("order", order, 1, MAX_ORDER)
    orders = [order, *([] if method.embedded is None else [method.embedded_order or 0])]
    if 0 in orders:
        raise CertificationError(
            f"{method.name or 'the method'}: the coefficients satisfy no order conditions"
        )
    packed = pack(method, orders)
    digits = max(len(coefficient.text) for coefficient in packed.coefficients)
    bits = 64 * math.ceil((math.log2(10) * digits + _GUARD_BITS) / 64)
    try:
        with working_precision(bits):
            if any(coefficient.unit for coefficient in packed.coefficients):
                box = find_box(packed, bits, complete)
            else:
                check_rational(packed)
                box = Box(Decimal(0), tuple(packed.names))
            beyond = find_violations(packed, box)
    except CertificationError as error:
        if order > method.order:
            error.args = (f"the order is {method.order}, not {order}: {error}",)
        raise
    second = (orders[1], beyond[1]) if len(orders) > 1 else (None, None)
    return Certificate(
        **vars(box), name=method.name, order=order, embedded_order=second[0], bits=bits,
        beyond=beyond[0], embedded_beyond=second[1],
    )  # fmt: skip


def check(certificate: Certificate, method: Method) -> None:
    """Prove what a certificate, which is a hint only, says of a method; else CertificationError."""
    check_instance("certificate", certificate, Certificate)
    check_instance("method", method, Method)
    packed = fitting(certificate, method)
    with working_precision(certificate.bits):
        if certificate.radius == 0:
            check_rational(packed)
        else:
            test = prove_zero(packed, certificate)
            check_left_out(packed, certificate, test, certificate.bits)
        check_violations(packed, certificate)


def find_violations(packed: PackedMethod, box: Box) -> list[ViolatedCondition]:
    """Return the condition of the next order that is violated most, of each row of weights."""
    violations: list[ViolatedCondition] = []
    for row, order in enumerate(packed.orders):
        words = packed.words(order + 1)
        bounds = _bounds(packed, box, words, row)
        best = max(range(len(words)), key=lambda k: bounds[k])
        if bounds[best] < _MIN_BOUND:
            raise CertificationError(
                f"{packed.name}: no condition of order {order + 1} is violated by much, "
                f"so order {order} isn't the highest, or coefficients are wrong",
                max_bound=float(bounds[best]),
            )
        numerator, denominator = map(Decimal, bounds[best].as_integer_ratio())
        violations.append(
            ViolatedCondition(words[best], _ROUNDED_DOWN.divide(numerator, denominator))
        )
    return violations


def check_violations(packed: PackedMethod, certificate: Certificate) -> None:
    """Prove that conditions of the next orders are violated; CertificationError if they aren't."""
    claims = [certificate.beyond, certificate.embedded_beyond]
    for row, (order, claim) in enumerate(zip(packed.orders, claims, strict=False)):
        if claim is None:
            raise CertificationError("second weights need a condition that they violate")
        if claim.word not in packed.words(order + 1):
            raise CertificationError(
                f"{claim.tree} is no independent condition of order {order + 1} of {packed.name}"
            )
        bound = _bounds(packed, certificate, [claim.word], row)[0]
        if not bound >= Fraction(claim.bound) >= _MIN_BOUND:
            raise CertificationError(
                f"{packed.name}: the condition of {claim.tree} isn't violated by as much as "
                f"{claim.bound}",
                bound=float(bound),
            )


def _bounds(packed: PackedMethod, box: Box, words: Sequence[Word], row: int) -> list[Fraction]:
    """Return lower bounds of the residuals' magnitudes in the box."""
    system = packed.equations([Condition(row, word) for word in words])
    values = system.residuals(packed.enclosure(box))
    return [exact_midpoint(value.abs_lower()) for value in values]
