"""Sets of contexts and letters that are orthogonal and together span all places.

The products of contexts u_i with letters v_j for the exact solution are rational numbers, M_ji. Row
reduction of M splits the contexts into a `reference` and others, which are made orthogonal to all
letters by multiples of the reference: u_i - Σ_r share_r u_r, the vectors of U_0. Exact arithmetic
decides which products are zero. Ranks of vectors are counted in double precision: a wrong count
leads to no relation, never to a wrong one.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions.words import reciprocal_density
from cg.construction.proofs.dependent.pairings import Pairing
from cg.construction.proofs.krawczyk import doubles
from cg.support import flint
from cg.support.balls import to_flint

_DEPENDENT = 1e-9  # largest remainder of a unit vector that depends on others

_Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class Spanned:
    """Contexts and letters, some of which span all places.

    `places` are those where neither all contexts nor all letters are zero for any coefficients;
    `contexts` and `columns` are indices into the pairing. Of the contexts those in `reference`,
    with the lowest degrees, reduce each other one to U_0, by multiples that `shares` has. `first`
    are contexts in U_0, `second` columns, that are independent; they may fill all places.
    """

    pairing: Pairing
    places: list[int]
    contexts: list[int]
    columns: list[int]
    second: list[int]

    @cached_property
    def _reduction(self) -> tuple[list[int], dict[int, list[flint.fmpq]]]:

        def exact(i: int, j: int) -> flint.fmpq:
            words = self.pairing.words(i, j)
            terms = (reciprocal_density(word) * m for (_, word), m in words.items())
            return to_flint(sum(terms, start=Fraction(0)))

        products = flint.fmpq_mat([[exact(i, j) for i in self.contexts] for j in self.columns])
        reduced, rank = products.rref()
        rows = reduced.tolist()[:rank]
        pivots = [next(k for k, entry in enumerate(row) if entry != 0) for row in rows]
        shares = {
            i: [row[k] for row in rows] for k, i in enumerate(self.contexts) if k not in set(pivots)
        }
        return [self.contexts[k] for k in pivots], shares

    @property
    def reference(self) -> list[int]:
        """Contexts that reduce the others to U_0."""
        return self._reduction[0]

    @property
    def shares(self) -> dict[int, list[flint.fmpq]]:
        """The multiples of the reference in each other context."""
        return self._reduction[1]

    @cached_property
    def first(self) -> list[int]:
        """Independent contexts in U_0."""
        keys = list(self.shares)
        chosen = independent_rows(doubles([self.left(i) for i in keys])) if keys else []
        return [keys[k] for k in chosen]

    @property
    def complete(self) -> bool:
        """Whether the independent contexts and columns fill all places."""
        return len(self.first) + len(self.second) == len(self.places)

    def right(self, column: int) -> list[flint.arb]:
        """Return a letter's vector."""
        vector = self.pairing.right[column]
        return [vector[j] for j in self.places]

    def left(self, context: int) -> list[flint.arb]:
        """Return a context's vector, in U_0."""
        vector = [self.pairing.left[context][j] for j in self.places]
        for other, share in zip(self.reference, self.shares[context], strict=True):
            if share != 0:
                reference = self.pairing.left[other]
                vector = [
                    x - flint.arb(share) * reference[j]
                    for x, j in zip(vector, self.places, strict=True)
                ]
        return vector

    def raw(self, context: int) -> dict[int, Any]:
        """Return a context, in U_0, as a combination of those of the pairing."""
        combination: dict[int, Any] = {context: flint.fmpq(1)}
        for other, share in zip(self.reference, self.shares[context], strict=True):
            if share != 0:
                combination[other] = combination.get(other, flint.fmpq(0)) - share
        return combination


def independent_rows(rows: _Doubles) -> list[int]:
    """Return the rows that don't depend on those before."""
    sizes = np.linalg.norm(rows, axis=1)
    least = _DEPENDENT * max(1.0, float(sizes.max(initial=0)))
    chosen: list[int] = []
    span = np.zeros((0, rows.shape[1]))
    for k, (row, size) in enumerate(zip(rows, sizes, strict=True)):
        if size <= least or len(span) == rows.shape[1]:
            continue
        rest = row / size
        for _ in range(2):
            rest = rest - rest @ span.T @ span
        left = float(np.linalg.norm(rest))
        if left > _DEPENDENT:
            span = np.vstack([span, rest / left])
            chosen.append(k)
    return chosen
