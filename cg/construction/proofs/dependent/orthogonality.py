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
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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

_NEW = 1e-5  # what must be left of a relation, to count as a new one
_REGULARITY_BITS = 128
_PROBES = 4

_Doubles = NDArray[np.float64]

Combination = dict[Word, Any]


def follow(
    layout: Layout, orders: Sequence[int], y: Sequence[flint.arb], left_out: Sequence[Condition]
) -> bool:
    """Return whether conditions left out hold wherever all others do, for coefficients in y."""
    relations = _Relations(layout, orders, y)
    chosen = relations.choose(len(left_out), [relations.position[c] for c in left_out])
    if len(chosen) < len(left_out):
        return False
    try:
        rows = relations.in_balls(chosen)
    except ZeroDivisionError:
        return False
    return _regular(flint.arb_mat([[row.get(c, flint.arb(0)) for c in left_out] for row in rows]))


def find_relations(
    layout: Layout, orders: Sequence[int], y: Sequence[flint.arb], most: int
) -> _Doubles:
    """Return at most `most` linear relations between residuals, in double precision.

    They are orthonormal rows, shape (relations, conditions), conditions as in `conditions_of`.
    """
    relations = _Relations(layout, orders, y)
    relations.choose(most)
    return relations.span


def _regular(matrix: flint.arb_mat) -> bool:
    """Return whether all matrices in a square ball matrix are regular."""
    size = matrix.nrows()
    try:
        inverse = np.linalg.inv(doubles(matrix.tolist())) if size else np.eye(0)
    except np.linalg.LinAlgError:
        return False
    if not np.isfinite(inverse).all():
        return False
    with working_precision(_REGULARITY_BITS):
        # close to the identity in the maximum norm, so regular
        rows = (flint.arb_mat(inverse.tolist()) * matrix).tolist()
        return all(
            sum((abs(x - int(i == j)) for j, x in enumerate(row)), flint.arb(0)) < 1
            for i, row in enumerate(rows)
        )


class _Choice(NamedTuple):
    """A context and a letter, beside those that fill all places."""

    spanned: Spanned
    context: int
    column: int


class _Relations:
    """Relations between residuals, for coefficients in balls."""

    def __init__(self, layout: Layout, orders: Sequence[int], y: Sequence[flint.arb]) -> None:
        self._layout, self._orders, self._y = layout, orders, y
        self.conditions = conditions_of(orders, layout.of_time)
        self.position = {c: k for k, c in enumerate(self.conditions)}
        self._rough = Reduction(float, lambda word: float(reciprocal_density(word)))
        self._products: dict[tuple[int, int, int], _Doubles] = {}
        self.span: _Doubles = np.zeros((0, len(self.conditions)))

    def choose(self, most: int, among: Sequence[int] = ()) -> list[_Choice]:
        """Choose independent relations; if conditions are given, independent in these."""
        chosen: list[_Choice] = []
        seen = list(among) or list(range(len(self.conditions)))
        basis = np.zeros((0, len(seen)))
        generator = np.random.default_rng(0)
        for spanned in self._spanned():
            if len(chosen) == most:
                break
            us, vs, rows = self._in_doubles(spanned)
            sizes = np.linalg.norm(rows, axis=1)
            unit = rows[:, seen] / np.maximum(sizes, 1e-300)[:, None]
            unit[sizes <= _NEW * sizes.max()] = 0
            # random combinations are in the span of the basis only if all rows are
            probes = generator.standard_normal((_PROBES, len(unit))) @ unit
            if np.linalg.norm(probes - probes @ basis.T @ basis, axis=1).max() < _NEW / 10:
                continue
            rest = unit - unit @ basis.T @ basis
            places = np.arange(len(rest))
            while len(chosen) < most:
                sizes = np.linalg.norm(rest, axis=1)
                left = sizes >= _NEW
                places, rest, sizes = places[left], rest[left], sizes[left]
                if not len(places):
                    break
                best = int(np.argmax(sizes))
                new = rest[best] / sizes[best]
                new = new - new @ basis.T @ basis
                new /= np.linalg.norm(new)
                basis = np.vstack([basis, new])
                rest = rest - np.outer(rest @ new, new)
                i, j = divmod(int(places[best]), len(vs))
                chosen.append(_Choice(spanned, us[i], vs[j]))
        self.span = basis
        return chosen

    def _spanned(self) -> Iterator[Spanned]:
        """Yield contexts and letters that fill all places, and have more."""
        seen: set[tuple[Any, ...]] = set()
        for which, pairing in enumerate(pairings(self._layout, self._orders, self._y)):
            degrees = np.array([u.degree for u in pairing.contexts])
            rows = np.array([u.row for u in pairing.contexts])
            sizes = np.array([c.degree for c in pairing.columns])
            left = doubles(pairing.left)
            right = doubles(pairing.right)
            around, within = _nonzero(pairing.left), _nonzero(pairing.right)
            for few, many, most_of_rows, most in self._cuts(within, around):
                columns = np.flatnonzero(few & (sizes <= most))
                contexts = np.flatnonzero(many & (degrees <= np.array(most_of_rows)[rows]))
                if not len(columns) or not len(contexts):
                    continue
                inside = around[contexts].any(axis=0) & within[columns].any(axis=0)
                places = np.flatnonzero(inside)
                key = (which, tuple(contexts), tuple(columns))
                if key in seen or not len(places):
                    continue
                seen.add(key)
                second = independent_rows(right[np.ix_(columns, places)])
                rank = len(independent_rows(left[np.ix_(contexts, places)]))
                # U_0 has at most `rank` dimensions, and at least as many less those of V's powers
                if len(second) == len(columns) or rank + len(second) < len(places):
                    continue
                spanned = Spanned(
                    pairing,
                    places.tolist(),
                    contexts.tolist(),
                    columns.tolist(),
                    second=[int(columns[k]) for k in second],
                )
                if spanned.complete and len(spanned.first) < len(spanned.shares):
                    yield spanned

    def _cuts(
        self, within: NDArray[np.bool_], around: NDArray[np.bool_]
    ) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_], tuple[int, ...], int]]:
        """Yield masks of letters and of contexts, and the largest degrees of contexts and letters.

        A mask takes vectors that are zero at the same places, whatever the coefficients are: these
        places then don't count.
        """
        for letters, contexts in product(_alike(within), _alike(around)):
            for most in range(1, self._orders[0]):
                for degrees in self._degrees(most):
                    yield letters, contexts, degrees, most

    def _degrees(self, most: int) -> Iterator[tuple[int, ...]]:
        """Yield the largest degrees of contexts of rows, and of their difference."""
        first = self._orders[0] - 1 - most
        if len(self._orders) == 1:
            yield (first,)
            return
        others = self._orders[1] - 1 - most
        for second in range(-1, others + 1):
            yield first, second, -1
        if others >= 0:
            yield -1, -1, others

    def _in_doubles(self, spanned: Spanned) -> tuple[list[int], list[int], _Doubles]:
        """Return contexts, letters, and the relation of each with each."""
        us = [i for i in spanned.shares if i not in set(spanned.first)]
        vs = [j for j in spanned.columns if j not in set(spanned.second)]
        left = {i: np.array([float(x) for x in spanned.left(i)]) for i in spanned.shares}
        right = {j: np.array([float(x) for x in spanned.right(j)]) for j in spanned.columns}
        delta = _coefficients([left[i] for i in spanned.first], [left[i] for i in us])
        beta = _coefficients([right[j] for j in spanned.second], [right[j] for j in vs])
        products = np.array(
            [
                [self._product(spanned.pairing, i, j) for j in spanned.columns]
                for i in spanned.contexts
            ]
        )
        at = {i: k for k, i in enumerate(spanned.contexts)}
        reduced = products.copy()
        for i, shares in spanned.shares.items():
            for other, share in zip(spanned.reference, shares, strict=True):
                if share != 0:
                    reduced[at[i]] -= float(share.p) / float(share.q) * products[at[other]]
        column = {j: k for k, j in enumerate(spanned.columns)}
        rest = reduced[:, [column[j] for j in vs]] - np.einsum(
            "iqt,jq->ijt", reduced[:, [column[j] for j in spanned.second]], beta
        )
        relations = rest[[at[i] for i in us]] - np.einsum(
            "pjt,ip->ijt", rest[[at[i] for i in spanned.first]], delta
        )
        return us, vs, relations.reshape(-1, len(self.conditions))

    def _product(self, pairing: Pairing, i: int, j: int) -> _Doubles:
        key = (id(pairing), i, j)
        if key not in self._products:
            vector = np.zeros(len(self.conditions))
            for (row, word), multiplicity in pairing.words(i, j).items():
                for reduced, value in self._rough(word).items():
                    vector[self.position[Condition(row, reduced)]] += multiplicity * value
            self._products[key] = vector
        return self._products[key]

    def in_balls(self, chosen: Sequence[_Choice]) -> list[dict[Condition, flint.arb]]:
        """Return the relations in ball arithmetic; ZeroDivisionError if vectors are dependent."""
        groups: dict[int, list[_Choice]] = {}
        relations = []
        for choice in chosen:
            groups.setdefault(id(choice.spanned), []).append(choice)
        for group in groups.values():
            spanned = group[0].spanned
            us = sorted({choice.context for choice in group})
            vs = sorted({choice.column for choice in group})
            delta, beta = _projections(
                [spanned.left(i) for i in spanned.first],
                [spanned.right(j) for j in spanned.second],
                [spanned.left(i) for i in us],
                [spanned.right(j) for j in vs],
            )
            for choice in group:
                left: dict[int, Any] = {}
                shares = [flint.arb(1), *(-share for share in delta[us.index(choice.context)])]
                terms = zip([choice.context, *spanned.first], shares, strict=True)
                factors = [
                    (k, s * flint.arb(f)) for i, s in terms for k, f in spanned.raw(i).items()
                ]
                for k, factor in factors:
                    left[k] = left.get(k, flint.arb(0)) + factor
                # the rest of the row belongs to U_0
                mine = zip(spanned.second, beta[vs.index(choice.column)], strict=False)
                right = {choice.column: flint.arb(1)} | {j: -share for j, share in mine}
                relations.append(self._combined(spanned.pairing, left, right))
        return relations

    @cached_property
    def _reductions(self) -> list[Reduction]:
        """Return the `Reduction` of each row of weights; elementary weights are balls."""
        reductions = []
        for row, order in enumerate(self._orders):
            words = condition_words(order - 1, False, self._layout.of_time) if order > 1 else ()
            quantities = [Quantity(self._layout.stages + row, word) for word in words]
            values = Weights(self._layout, quantities).evaluate(self._y[: self._layout.size])
            known = dict(zip(words, values, strict=True))
            reductions.append(Reduction(to_ball, known.__getitem__))
        return reductions

    def _combined(
        self, pairing: Pairing, left: dict[int, flint.arb], right: dict[int, flint.arb]
    ) -> dict[Condition, flint.arb]:
        combination: dict[Condition, flint.arb] = {}
        for i, a in left.items():
            for j, b in right.items():
                product = a * b
                for key, multiplicity in pairing.words(i, j).items():
                    add_multiple(combination, key, product * multiplicity)
        # residuals of words as those of conditions
        reduced: dict[Condition, flint.arb] = {}
        for row, reduction in enumerate(self._reductions):
            terms = [(word, value) for (r, word), value in combination.items() if r == row]
            for word, value in reduction.total(terms).items():
                reduced[Condition(row, word)] = value
        return reduced


def _projections(
    first: list[list[flint.arb]],
    second: list[list[flint.arb]],
    us: list[list[flint.arb]],
    vs: list[list[flint.arb]],
) -> tuple[list[list[flint.arb]], list[list[flint.arb]]]:
    """Return by which combinations of the first two other vectors are to be reduced."""
    both = flint.arb_mat([*second, *first]).transpose()
    beta = both.solve(flint.arb_mat(vs).transpose()).transpose().tolist()
    if not first:
        return [[] for _ in us], beta
    rows = flint.arb_mat(first)
    products = rows * flint.arb_mat(us).transpose()
    return (rows * rows.transpose()).solve(products).transpose().tolist(), beta


def _coefficients(basis: Sequence[_Doubles], vectors: Sequence[_Doubles]) -> _Doubles:
    if not basis:
        return np.zeros((len(vectors), 0))
    return np.asarray(np.linalg.lstsq(np.array(basis).T, np.array(vectors).T, rcond=None)[0].T)


def _nonzero(vectors: Sequence[Sequence[flint.arb]]) -> NDArray[np.bool_]:
    return np.array([[not x.is_zero() for x in vector] for vector in vectors])


def _alike(nonzero: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Return sets of vectors: all, and those that are zero wherever one of them is."""
    zeros = sorted({tuple(row) for row in ~nonzero}, key=lambda row: (sum(row), row))
    sets = [np.array([True] * len(nonzero))]
    for row in zeros:
        if any(row):
            sets.append(np.asarray(~nonzero[:, list(row)].any(axis=1)))
    return sets


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
        self._known: dict[Word, Combination] = {}

    def __call__(self, word: Word) -> Combination:
        """Return the coefficients by condition."""
        if word not in self._known:
            self._known[word] = self._reduced(word)
        return self._known[word]

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
        first, rest = word[:cut], word[cut:]
        shuffled = shuffle(first, rest)
        share = self._number(1) / shuffled[word]
        terms = [
            (rest, share * self._number(reciprocal_density(first))),
            (first, share * self._weight(rest)),
        ]
        terms += [(w, -share * m) for w, m in shuffled.items() if w != word]
        return self.total(terms)
