"""How a proof of a zero is found: what to hold, which radius, which identities."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .certificate import Certificate, CertificationError
from .dependent.orthogonality import ResidualRelation, conditions_of, find_relations
from .explain import STRUCTURES, LeftOut, augmented_system, find_identities
from .krawczyk import KrawczykTest, choose_free, krawczyk, numerical_rank, to_double
from .statement import Packed, orders_of, system_of
from .systems import EquationSystem, order_system
from .zero import check_left_out, check_places, largest_residual, quantities, zero_of


class _Proved(NamedTuple):
    """A proved certificate and its Krawczyk test."""

    certificate: Certificate
    attempt: KrawczykTest


def find_zero(packed: Packed, draft: Certificate, small: bool = False) -> Certificate:
    """Return a draft with a zero near the stored coefficients that is proved.

    `draft` has all that isn't searched for: names, orders, bits. With `small`, conditions that
    depend on others need no proof but that they are small. CertificationError if no zero can be
    proved.
    """
    y = packed.balls()
    system = order_system(packed.layout, draft.order, draft.embedded_order)
    values, jacobian = system.linearise(y)
    check_places(packed, system, values, jacobian)
    outcome = _try(packed, draft, system, to_double(jacobian))
    if isinstance(outcome, _Proved):
        return outcome.certificate
    if small:
        return _of_independent(packed, draft, to_double(jacobian))
    tried: list[str] = []
    for identities in find_identities(packed.layout, packed.values, packed.zeros()):
        names = tuple(identity.name for identity in identities)
        tried.append(" and ".join(names))
        extended = replace(draft, identities=names)
        system = augmented_system(packed.layout, orders_of(draft), identities, packed.zeros())
        again = _try(packed, extended, system, to_double(system.linearise(y)[1]))
        if isinstance(again, _Proved):
            return again.certificate
    orthogonal, relations = _orthogonal(packed, draft, to_double(jacobian))
    tried.append(f"orthogonality, by which {relations} conditions follow")
    if orthogonal is not None:
        system = system_of(packed, orthogonal)
        again = _try(packed, orthogonal, system, to_double(system.linearise(y)[1]))
        if isinstance(again, _Proved):
            check_left_out(packed, *again)
            return again.certificate
        outcome = again
    message = f"{draft.name}: no zero of the conditions of order {draft.order} is proved"
    if outcome["rank"] < outcome["conditions"]:
        message += ", their derivatives are dependent and no known identities explain that"
    raise CertificationError(message, **outcome, tried="; ".join(tried))


def _of_independent(
    packed: Packed, draft: Certificate, jacobian: NDArray[np.float64]
) -> Certificate:
    """Prove a zero of as many conditions as are independent, and that the others are small."""
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    rank = numerical_rank(jacobian[:, nonzero])[0]
    pivots = linalg.qr(jacobian[:, nonzero].T, mode="r", pivoting=True)[1]
    conditions = conditions_of(orders_of(draft), packed.layout.of_time)
    left_out = [conditions[k] for k in sorted(map(int, pivots[rank:]))]
    draft = replace(draft, identities=LeftOut(left_out, bound="1e-40").names)
    system = system_of(packed, draft)
    kept = np.delete(jacobian, [conditions.index(one) for one in left_out], axis=0)
    outcome = _try(packed, draft, system, kept)
    if not isinstance(outcome, _Proved):
        raise CertificationError(f"{draft.name}: no zero of independent conditions", **outcome)
    proved, attempt = outcome
    zero = zero_of(packed, proved, attempt)
    largest = float(largest_residual(packed, left_out, zero))
    # a power of ten, with room for another rounding
    bound = f"1e{math.ceil(math.log10(max(largest, 1e-300))) + 1}"
    proved = replace(proved, identities=LeftOut(left_out, bound=bound).names)
    check_left_out(packed, proved, attempt)
    return proved


def _orthogonal(
    packed: Packed, draft: Certificate, jacobian: NDArray[np.float64]
) -> tuple[Certificate | None, int]:
    """Return a draft that leaves out what follows by orthogonality, and how much does.

    None if the conditions that are left would still depend on each other.
    """
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    orders = orders_of(draft)
    every = {name: make(packed.layout, orders, packed.values) for name, make in STRUCTURES.items()}
    name = next((name for name, one in every.items() if one.satisfied()), "")
    known: list[ResidualRelation] = []
    along = jacobian[:, nonzero]
    if name:
        known = list(every[name].relations(packed.balls()))
        system = EquationSystem(packed.layout, tuple(every[name].equations()))
        held = to_double(system.linearise(packed.balls())[1])[:, nonzero]
        along = along @ linalg.null_space(held)
    dependent = len(jacobian) - numerical_rank(along)[0]
    relations = find_relations(packed.layout, orders, packed.balls(), dependent, known)
    if len(relations) < max(dependent, 1):
        return None, len(relations)
    pivots = linalg.qr(relations, mode="r", pivoting=True)[1][:dependent]
    conditions = conditions_of(orders, packed.layout.of_time)
    left_out = [conditions[k] for k in sorted(map(int, pivots))]
    return replace(draft, identities=LeftOut(left_out, name).names), dependent


def _try(
    packed: Packed, draft: Certificate, system: EquationSystem, jacobian: NDArray[np.float64]
) -> _Proved | dict[str, float]:
    """Return the certificate with the zero proved, or the quantities that tell why not."""
    names = packed.layout.names
    size = len(system.equations)
    rough = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.unit]
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    measures: dict[str, float] = {}
    for movable in (rough, nonzero):  # better to hold all that are exact, not zeros only
        rank, singular = numerical_rank(jacobian[:, movable])
        measures = {
            "conditions": size,
            "rank": rank,
            "smallest_singular_value": float(singular[-1]),
        }
        measures["largest_singular_value"] = float(singular[0])
        if rank < size:
            continue
        free = choose_free(jacobian * packed.preferences, movable)
        attempt = krawczyk(system, packed.balls(), free)
        measures |= quantities(attempt)
        if attempt.proved:
            fixed = tuple(name for k, name in enumerate(names) if k not in set(free))
            radius = f"{float(attempt.radius):.1e}"
            return _Proved(replace(draft, radius=radius, fixed=fixed), attempt)
    return measures
