"""Conditions that follow since orthogonal vectors span all stages, or all flows.

An order condition gives the product of a context and a letter (`pairings`) its value for the exact
solution. Take some contexts and letters. Let U_0 be the combinations of contexts whose products
with all these letters are zero for the exact solution, and V the letters. With n places, stages or
flows, let a vectors of U_0 and b of V be independent with a + b = n. Then V spans the orthogonal
complement of U_0, and with v = Σ β_j v_j for another letter and u = Σ δ_i u_i for another
context,

    (u, v) - Σ β_j (u, v_j) - Σ δ_i (u_i, v) + Σ β_j δ_i (u_i, v_j) = 0

as long as the (u_i, v_j) are zero. Where they aren't, let v = Σ β_j v_j + Σ γ_i u_i, and δ the
solution of ``(u - Σ δ_i u_i, u_k) = 0`` for all k: the same is true. All products being
residuals, this is a linear relation between these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, cached_property
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.conditions.exact import (
    Condition,
    Quantity,
    Weights,
    Word,
    add_multiple,
    condition_words,
    conditions_of,
    nodes,
    reciprocal_density,
    shuffle,
)
from cg.construction.layouts import Layout
from cg.construction.proofs.dependent.pairings import Pairing, Spanned, independent_rows, pairings
from cg.construction.proofs.krawczyk import doubles
from cg.support import flint
from cg.support.quads import to_ball, working_precision

_NEW = 1e-5  # least part of a new relation that is orthogonal to the others
_REGULARITY_BITS = 128

_Doubles = NDArray[np.float64]

Combination = dict[Word, Any]


def prove_dependent(
    layout: Layout, orders: Sequence[int], y: Sequence[flint.arb], left_out: Sequence[Condition]
) -> bool:
    """Return whether conditions left out hold wherever all others do, for coefficients in y."""
    relations = _Relations(layout, orders, y)
    chosen, _ = relations.choose(len(left_out), [relations.position[c] for c in left_out])
    if len(chosen) < len(left_out):
        return False
    rows = [relations.in_balls(*choice) for choice in chosen]
    with working_precision(_REGULARITY_BITS):
        try:
            flint.arb_mat([[row.get(c, flint.arb(0)) for c in left_out] for row in rows]).inv()
        except ZeroDivisionError:  # they may depend on each other
            return False
    return True


def find_relations(
    layout: Layout, orders: Sequence[int], y: Sequence[flint.arb], count: int
) -> _Doubles:
    """Return at most `count` linear relations between residuals, in double precision.

    They are orthonormal rows, shape (relations, conditions), conditions as in `conditions_of`.
    """
    return _Relations(layout, orders, y).choose(count)[1]


class _Relations:
    """Relations between residuals, for coefficients in balls."""

    def __init__(self, layout: Layout, orders: Sequence[int], y: Sequence[flint.arb]) -> None:
        self._layout, self._orders, self._y = layout, orders, y
        self.conditions = conditions_of(orders, layout.of_time)
        self.position = {c: k for k, c in enumerate(self.conditions)}
        self._rough = Reduction(float, lambda word: float(reciprocal_density(word)))
        self._products: dict[tuple[int, int, int], _Doubles] = {}

    def choose(
        self, limit: int, among: Sequence[int] = ()
    ) -> tuple[list[tuple[Spanned, int, int]], _Doubles]:
        """Choose independent relations, each by indices of `us` and `vs`, and return their span.

        With indices of conditions they are independent in these, and so is the span.
        """
        chosen: list[tuple[Spanned, int, int]] = []
        seen = list(among) or list(range(len(self.conditions)))
        basis = np.zeros((0, len(seen)))
        for spanned in self._spanned():
            if len(chosen) == limit:
                break
            try:
                rows = self._in_doubles(spanned)
            except ZeroDivisionError:  # balls are too large
                continue
            sizes = np.linalg.norm(rows, axis=1)
            unit = rows[:, seen] / np.maximum(sizes, 1e-300)[:, None]
            projected = unit - unit @ basis.T @ basis
            new = (sizes > _NEW * sizes.max()) & (np.linalg.norm(projected, axis=1) >= _NEW)
            indices = np.flatnonzero(new)
            if not indices.size:
                continue
            columns, triangle, pivots = linalg.qr(projected[new].T, mode="economic", pivoting=True)
            count = min(int(np.sum(np.abs(np.diag(triangle)) >= _NEW)), limit - len(chosen))
            basis = np.vstack([basis, columns[:, :count].T])
            pairs = (divmod(k, len(spanned.vs)) for k in indices[pivots[:count]].tolist())
            chosen += [(spanned, m, n) for m, n in pairs]
        return chosen, basis

    def _spanned(self) -> Iterator[Spanned]:
        """Yield sets of contexts and letters that span all places, with vectors to spare.

        Places count where the vectors of a set aren't zero for all coefficients. Letters have at
        most a degree, and contexts at least this degree left, so that all products are conditions,
        of the first row or of both.
        """
        seen: set[tuple[Any, ...]] = set()
        orders = np.array(self._orders)
        for number, pairing in enumerate(pairings(self._layout, self._orders, self._y)):
            rows = np.array([u.row for u in pairing.contexts])
            room = orders[rows] - 1 - np.array([u.degree for u in pairing.contexts])
            sizes = np.array([c.degree for c in pairing.columns])
            left, right = doubles(pairing.left), doubles(pairing.right)
            around, within = _nonzero(pairing.left), _nonzero(pairing.right)
            for few, many, degree, last in product(
                _alike(within), _alike(around), range(1, orders[0]), range(len(orders))
            ):
                columns = np.flatnonzero(few & (sizes <= degree))
                contexts = np.flatnonzero(many & (room >= degree) & (rows <= last))
                inside = around[contexts].any(axis=0) & within[columns].any(axis=0)
                places = np.flatnonzero(inside)
                key = (number, tuple(contexts), tuple(columns))
                if key in seen or not len(places):
                    continue
                seen.add(key)
                second = columns[independent_rows(right[np.ix_(columns, places)])]
                rank = len(independent_rows(left[np.ix_(contexts, places)]))
                # dim U_0 <= rank: if U_0 can't fill the places that the second rows leave, the rows
                # needn't be reduced exactly
                if len(second) == len(columns) or rank + len(second) < len(places):
                    continue
                indices = (places, contexts, columns, second)
                spanned = Spanned(pairing, *(each.tolist() for each in indices))
                if spanned.complete:
                    yield spanned

    def _in_doubles(self, spanned: Spanned) -> _Doubles:
        """Return the relations of each of `us` with each of `vs`."""
        delta, beta = map(doubles, spanned.shares)
        contexts = _matrix([spanned.combinations[i] for i in spanned.us], spanned.contexts)
        first = _matrix([spanned.combinations[i] for i in spanned.first], spanned.contexts)
        unit = np.eye(max(spanned.columns) + 1)[:, spanned.columns]
        left = contexts - delta @ first
        right = unit[spanned.vs] - beta[:, : len(spanned.second)] @ unit[spanned.second]
        products = [
            [self._product(spanned.pairing, i, j) for j in spanned.columns]
            for i in spanned.contexts
        ]
        relations = np.einsum("ik,kjt,lj->ilt", left, np.array(products), right, optimize=True)
        return np.asarray(relations).reshape(-1, len(self.conditions))

    def _product(self, pairing: Pairing, i: int, j: int) -> _Doubles:
        key = (id(pairing), i, j)
        if key not in self._products:
            vector, row = np.zeros(len(self.conditions)), pairing.contexts[i].row
            for word, value in self._rough.total(pairing.words(i, j).items()).items():
                vector[self.position[Condition(row, word)]] = value
            self._products[key] = vector
        return self._products[key]

    def in_balls(self, spanned: Spanned, m: int, n: int) -> dict[Condition, flint.arb]:
        """Return the relation of one of `us` and one of `vs`."""
        pairing, (left, right) = spanned.pairing, spanned.sides(m, n)
        combinations: list[Combination] = [{} for _ in self._orders]
        for i, a in left.items():
            for j, b in right.items():
                share = a * b
                for word, multiplicity in pairing.words(i, j).items():
                    add_multiple(combinations[pairing.contexts[i].row], word, share * multiplicity)
        reduced = zip(self._reductions, combinations, strict=True)
        return {
            Condition(row, word): value
            for row, (reduction, combination) in enumerate(reduced)
            for word, value in reduction.total(combination.items()).items()
        }

    @cached_property
    def _reductions(self) -> list[Reduction]:
        """The `Reduction` of each row of weights; elementary weights are balls."""
        reductions = []
        for row, order in enumerate(self._orders):
            words = condition_words(order - 1, False, self._layout.of_time) if order > 1 else ()
            quantities = [Quantity(self._layout.stages + row, word) for word in words]
            values = Weights(self._layout, quantities).evaluate(self._y[: self._layout.size])
            weights = dict(zip(words, values, strict=True))
            reductions.append(Reduction(to_ball, weights.__getitem__))
        return reductions


def _matrix(combinations: Sequence[dict[int, flint.arb]], names: Sequence[int]) -> _Doubles:
    """Return the coefficients of combinations by name, shape (combinations, names)."""
    rows = [[float(combination.get(name, 0)) for name in names] for combination in combinations]
    return np.array(rows).reshape(-1, len(names))


def _nonzero(vectors: Sequence[Sequence[flint.arb]]) -> NDArray[np.bool_]:
    return np.array([[not x.is_zero() for x in vector] for vector in vectors])


def _alike(nonzero: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Return sets of vectors, large ones first: all, and those that are zero wherever two are."""
    patterns = np.unique(np.vstack([~nonzero, np.zeros_like(nonzero[:1])]), axis=0)
    pairs = combinations_with_replacement(patterns, 2)
    sets = np.unique([~nonzero[:, one & other].any(axis=1) for one, other in pairs], axis=0)
    return sorted(sets, key=lambda chosen: -np.count_nonzero(chosen))


@cache
def _conditions(count: int) -> frozenset[Word]:
    return frozenset(condition_words(count))


@cache
def _first_condition(word: Word) -> int:
    """Return the length of the longest condition that the word begins with."""
    lengths = range(len(word), 0, -1)
    return next(k for k in lengths if word[:k] in _conditions(nodes(word[:k])))


class Reduction:
    """Residuals of words as combinations of those of independent conditions.

    Weights multiply by shuffles, and so do their values for the exact solution. So for words u and
    v

        Σ_{w in u ⧢ v} residual(w) = 1/γ(u) residual(v) + Φ(v) residual(u),

    and a word that is no condition is expressed by shuffling its first condition with the rest.
    `number` makes a coefficient of a Fraction. `weight` returns Φ of a word: a ball that contains
    it, or the `number` of its value for the exact solution.
    """

    def __init__(self, number: Callable[[Any], Any], weight: Callable[[Word], Any]) -> None:
        self._number, self._weight = number, weight
        self._combinations: dict[Word, Combination] = {}

    def __call__(self, word: Word) -> Combination:
        """Return the coefficients by condition."""
        if word not in self._combinations:
            self._combinations[word] = self._reduced(word)
        return self._combinations[word]

    def total(self, terms: Iterable[tuple[Word, Any]]) -> Combination:
        """Return a combination of residuals of words, coefficients of the number type."""
        total: Combination = {}
        for word, factor in terms:
            for condition, value in self(word).items():
                add_multiple(total, condition, factor * value)
        return total

    def _reduced(self, word: Word) -> Combination:
        cut = _first_condition(word)
        if cut == len(word):
            return {word: self._number(1)}
        u, v = word[:cut], word[cut:]
        shuffled = shuffle(u, v)
        share = self._number(1) / shuffled[word]
        terms = [
            (v, share * self._number(reciprocal_density(u))),
            (u, share * self._weight(v)),
        ]
        terms += [(w, -share * m) for w, m in shuffled.items() if w != word]
        return self.total(terms)
