"""How a proof of a zero is found: what to hold, what to leave out, which radius.

The pivots of a QR factorisation of the Jacobian choose the coefficients that move, those of the
matrix of relations between residuals the conditions to leave out: both keep the remaining square
Jacobian well conditioned, on which the radius of Krawczyk's test depends. Nothing here is trusted:
`zero` proves what was found.
"""

import math
from dataclasses import replace
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.proofs.certificate import Box, CertificationError
from cg.construction.proofs.dependent.orthogonality import find_relations
from cg.construction.proofs.krawczyk import (
    KrawczykTest,
    choose_movable,
    doubles,
    krawczyk,
    numerical_rank,
)
from cg.construction.proofs.packed import Packed, PackedWeights
from cg.construction.proofs.zero import check_left_out, check_places, largest_residual

SMALL_PLACES = 300
"""Conditions that are only shown to be small are evaluated to this many places."""


class _Proved(NamedTuple):
    """A box and its Krawczyk test; what the box says of conditions left out isn't proved yet."""

    box: Box
    attempt: KrawczykTest


def find_box(packed: Packed, bits: int, complete: bool = False) -> Box:
    """Return a box in which the conditions have a zero that is proved, or raise.

    Unless `complete`, conditions that depend on others for unknown reasons are shown to be small.
    """
    values, derivatives = packed.system().linearise(packed.balls())
    check_places(packed, values, derivatives)
    jacobian = doubles(derivatives.tolist())
    outcome = _try(packed, np.array([], dtype=np.intp), jacobian)
    if isinstance(outcome, _Proved):
        return outcome.box
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
            outcome = _try(packed, left_out, jacobian)
        if isinstance(outcome, _Proved):
            if not explained:
                # with a bound of the conditions that are left out, a power of ten
                largest = float(largest_residual(packed, *outcome, SMALL_PLACES, bits))
                exponent = max(math.ceil(math.log10(max(largest, 1e-307))), -SMALL_PLACES)
                return replace(outcome.box, bound=Decimal((0, (1,), exponent)))
            check_left_out(packed, *outcome, bits)
            return outcome.box
    raise CertificationError(message, **outcome)


def _try(
    packed: Packed, left_out: NDArray[np.signedinteger[Any]], jacobian: NDArray[np.float64]
) -> _Proved | dict[str, float]:
    """Return the box with a zero proved, or quantities that tell why there is none."""
    omitted = [packed.conditions[k] for k in sorted(map(int, left_out))]
    system = packed.system(omitted)
    jacobian = np.delete(jacobian, left_out, axis=0)
    rough = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.unit]
    nonzero = [k for k, coefficient in enumerate(packed.coefficients) if coefficient.value]
    measures: dict[str, float] = {}
    for candidates in (rough, nonzero):  # better to hold all that are exact, not zeros only
        rank, singular = numerical_rank(jacobian[:, candidates])
        measures = {
            "conditions": len(jacobian),
            "rank": rank,
            "smallest_singular_value": float(singular[-1]),
            "largest_singular_value": float(singular[0]),
        }
        if rank < len(jacobian):
            continue
        # exact coefficients are held if possible
        preferences = np.where([c.unit == 0 for c in packed.coefficients], 1e-6, 1.0)
        movable = choose_movable(jacobian * preferences, candidates)
        attempt = krawczyk(system, packed.balls(), movable)
        measures |= attempt.quantities
        if attempt.proved:
            held = sorted(set(range(len(packed.names))) - set(movable))
            fixed = tuple(packed.names[k] for k in held)
            radius = Decimal(f"{float(attempt.radius):.1e}")
            return _Proved(Box(radius, fixed, tuple(omitted)), attempt)
    return measures
