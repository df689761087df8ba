"""Words with a slot and letters, as vectors over stages or flows, and their inner products.

A context is a word with a slot, in place of a letter, which is filled with other letters. The
weight Φ(h(v)) of a context h filled with a letter v is linear in the values of v at the stages. So
a context is a vector, whose product with that of a letter is the weight of a word: conditions
become statements on vectors, which linear algebra relates (`orthogonality`). The weight is a sum
over the stages k, or the flows m,

    Φ(h(v)) = Σ_k left_k(h) Φ_k(v) = Σ_m left_m(h) right_m(v),   right_m(v) = Σ_k y_mk Φ_k(v),

with the coefficient y_mk of the flow to point m on stage k. `Pairing.left` has the vectors of the
contexts, `Pairing.right` those of the letters. The vectors over the flows are derivatives of
weights by letters, `Weights.slopes`; those over the stages follow from them.

`Spanned` are sets of contexts and letters that are orthogonal and together span all places. The
products of contexts u_i with letters v_j for the exact solution are rational numbers, M_ji. Row
reduction of M splits the contexts into pivots and others, which are made orthogonal to all letters
by multiples of the pivots: u_i - Σ_r share_r u_r, the vectors of U_0. Exact arithmetic decides
which products are zero. Ranks of vectors are counted in double precision: a wrong count leads to no
relation, never to a wrong one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.conditions.exact import (
    Quantity,
    Weights,
    Word,
    add_multiple,
    condition_words,
    extend,
    nodes,
    reciprocal_density,
    shuffle,
    words_with,
)
from cg.construction.layouts import Layout
from cg.construction.proofs.krawczyk import doubles
from cg.support import flint
from cg.support.quads import to_flint

Vector = list[Any]
_Around = dict[tuple[int, Word], Vector]  # by row and context: the vector over the flows
_Values = dict[Word, Vector]  # by letter: its weights at the stages

SLOT: Any = -1  # where a letter was cut out of a word

_DEPENDENT = 1e-9  # largest remainder of a unit vector that depends on others

_Doubles = NDArray[np.float64]


class Context(NamedTuple):
    """A word with a slot along a row of weights, times the values of a letter at stages."""

    row: int
    context: Word
    factor: Word = ()

    @property
    def degree(self) -> int:
        """Number of nodes of a word besides the letter in the slot."""
        return outer_nodes(self.context) + nodes(self.factor)


class Column(NamedTuple):
    """A letter, given by the children of its tree, or its moments, taken repeatedly."""

    letter: Word
    moments: int = 0

    @property
    def degree(self) -> int:
        """Number of nodes that the column adds to a word, without the letter's root."""
        return nodes(self.letter) + self.moments


@dataclass(frozen=True)
class Pairing:
    """Contexts and letters as vectors over the same places, stages or flows."""

    contexts: list[Context]
    columns: list[Column]
    left: list[Vector]  # vector of each context; exactly zero where it is for all coefficients
    right: list[Vector]  # vector of each column

    def words(self, i: int, j: int) -> dict[Word, int]:
        """Return the words whose weights, along the context's row, add up to a product."""
        u, column = self.contexts[i], self.columns[j]
        contexts = {u.context: 1}
        for _ in range(column.moments):
            contexts = extend(moments, contexts)
        letters = shuffle(u.factor, column.letter)
        weights: dict[Word, int] = {}
        for context, factor in contexts.items():
            for letter, multiplicity in letters.items():
                add_multiple(weights, fill(context, letter), factor * multiplicity)
        return weights


def pairings(
    layout: Layout, orders: Sequence[int], y: Sequence[flint.arb]
) -> tuple[Pairing, Pairing]:
    """Return the pairing over the stages and that over the flows, for coefficients in balls `y`.

    `orders` are those of the rows of weights; they bound the nodes of words.
    """
    max_order = orders[0] - 1
    of_time = layout.of_time
    words = sorted([(), *condition_words(max_order, False, of_time)], key=nodes)
    letters = [w for w in words if not any(w)] if of_time else words
    contexts = [(row, h) for row, q in enumerate(orders) for h in ((SLOT,), *basis(q - 2, of_time))]
    ends = range(len(layout.ends))
    weights = Weights(layout, [Quantity(end, w) for w in words for end in ends])
    values_of_weights = iter(weights.evaluate(y[: layout.size]))
    at_ends = {w: [next(values_of_weights) for _ in ends] for w in words}
    values = {w: at_ends[w][: layout.stages] for w in letters}
    around = {(row, h): _adjoint(weights, y, layout.stages + row, h) for row, h in contexts}
    return (
        _over_stages(layout, orders, y, around, values),
        _over_flows(layout, max_order, y, around, values),
    )


def _over_stages(
    layout: Layout, orders: Sequence[int], y: Sequence[flint.arb], around: _Around, values: _Values
) -> Pairing:
    """Return the vectors over the stages, from those over the flows and letters' values."""
    contexts = [
        Context(row, h, factor)
        for row, h in around
        for factor in values
        if outer_nodes(h) + nodes(factor) <= orders[row] - 2
    ]
    contexts.sort(key=lambda u: u.degree)
    at_stages = {key: _to_stages(layout, y, vector) for key, vector in around.items()}
    left = [
        [a * b for a, b in zip(at_stages[u.row, u.context], values[u.factor], strict=True)]
        for u in contexts
    ]
    return Pairing(contexts, [Column(w) for w in values], left, list(values.values()))


def _over_flows(
    layout: Layout, max_order: int, y: Sequence[flint.arb], around: _Around, values: _Values
) -> Pairing:
    """Return the vectors over the flows, those of letters with their moments."""
    contexts = sorted((Context(row, h) for row, h in around), key=lambda u: u.degree)
    right: dict[Column, Vector] = {}
    for w, at_stages in values.items():
        vector: Vector = [
            sum((y[k] * at_stages[s] for k, s in _terms(layout, m)), flint.arb(0))
            for m in range(len(layout.parents))
        ]
        for k in range(max_order - nodes(w) + 1):
            right[Column(w, k)] = vector
            vector = _moments_of(layout, y, vector)
    columns = sorted(right, key=lambda c: c.degree)
    return Pairing(
        contexts, columns, [around[u.row, u.context] for u in contexts], [right[c] for c in columns]
    )


def _adjoint(weights: Weights, y: Sequence[flint.arb], end: int, context: Word) -> Vector:
    """Return a word with a slot as a vector over the flows: derivatives by the letter in it.

    The word is one at the end of a row.
    """
    layout, ends = weights.layout, {end: flint.arb(1)}
    while True:
        outer, inner = _cut(context)
        slot = outer.index(SLOT)
        flows: Vector = [flint.arb(0)] * len(layout.parents)
        for row, factor in ends.items():
            if not factor.is_zero():
                slopes = weights.slopes(row, outer[:slot], outer[slot + 1 :])
                for m in layout.path(layout.ends[row]):
                    flows[m] = flows[m] + factor * slopes[m]
        if not inner:
            return flows
        ends, context = dict(enumerate(_to_stages(layout, y, flows))), inner


def _cut(context: Word) -> tuple[Word, Word]:
    """Return a word with the slot in place of the letter that has it, and that letter's word."""
    for k, letter in enumerate(context):
        if has_slot(letter):
            return (*context[:k], SLOT, *context[k + 1 :]), letter
    return context, ()


def _terms(layout: Layout, point: int) -> list[tuple[int, int]]:
    """Return the unknowns of a flow, each with its stage."""
    return list(enumerate(layout.weights[point], layout.starts[point]))


def _to_stages(layout: Layout, y: Sequence[flint.arb], flows: Vector) -> Vector:
    vector: list[Any] = [flint.arb(0)] * layout.stages
    for m, value in enumerate(flows):
        for k, stage in _terms(layout, m):
            vector[stage] = vector[stage] + y[k] * value
    return vector


def _moments_of(layout: Layout, y: Sequence[flint.arb], flows: Vector) -> Vector:
    """Return the vector of the moments of a letter from that of the letter, v.

    They grow by ``s dv - v ds`` along a path, where s is the weight of τ; see `moments`. On the
    flow to point m this is ``s v_m - s_m V``, with s and the sum V of v at its start, and its own
    s_m: the products of what s and v gain on the flow itself cancel.
    """
    # s and V at the end of each flow, and last at the start, where both are exactly 0
    ends: Vector = [flint.arb(0)] * (len(flows) + 1)
    after: Vector = [flint.arb(0)] * (len(flows) + 1)
    moments_of_flows: Vector = []
    for m, parent in enumerate(layout.parents):
        step = sum((y[k] for k, _ in _terms(layout, m)), flint.arb(0))
        moments_of_flows.append(ends[parent] * flows[m] - step * after[parent])
        ends[m], after[m] = ends[parent] + step, after[parent] + flows[m]
    return moments_of_flows


@cache
def basis(order: int, of_time: bool = False) -> tuple[Word, ...]:
    """Return the contexts with at most `order` nodes around the slot, from which others follow.

    Shuffles bring the slot into the last letter of the root. In words of powers of the time the
    slot is a letter itself.
    """
    counts = range(1, order + 1)
    return tuple(h for count in counts for h in _with_slot(count, last=True, of_time=of_time))


@cache
def _with_slot(count: int, last: bool, of_time: bool = False) -> tuple[Word, ...]:
    words: list[Word] = []
    for inside in range(1 if of_time else count + 1):
        # a word is split into the letter with the slot, and words before and after it
        letters = [SLOT] if inside == 0 else list(_with_slot(inside - 1, last=False))
        for before in range(count - inside + 1):
            after = count - inside - before
            if after and last:
                continue
            words += [
                (*left, letter, *right)
                for letter in letters
                for left in words_with(before, of_time)
                for right in words_with(after, of_time)
            ]
    return tuple(words)


@cache
def outer_nodes(context: Word) -> int:
    """Return the number of nodes around the slot."""
    return sum(0 if t == SLOT else 1 + outer_nodes(t) for t in context)


def has_slot(letter: Any) -> bool:
    """Return whether the slot is within a letter."""
    return letter != SLOT and any(t == SLOT or has_slot(t) for t in letter)


def fill(context: Word, letter: Word) -> Word:
    """Put a letter into the slot of a context."""
    return tuple(letter if t == SLOT else fill(t, letter) for t in context)


@cache
def moments(context: Word) -> dict[Word, int]:
    """Return the combination of contexts whose product with v is that with the moments of v.

    Along the path of the slot, the moments of v grow by ``s dv - v ds``, where s is the weight of τ
    up to there. So a word ``p * q`` becomes ``(τ ⧢ p) * q`` minus all ``p' * p'' τ q`` with
    ``p = p' p''``.
    """
    words: dict[Word, int] = {}

    if SLOT in context:
        slot = context.index(SLOT)
        before, after = context[:slot], context[slot + 1 :]
        for word, multiplicity in shuffle(((),), before).items():
            add_multiple(words, (*word, SLOT, *after), multiplicity)
        for cut in range(slot + 1):
            add_multiple(words, (*before[:cut], SLOT, *before[cut:], (), *after), -1)
    for k, letter in enumerate(context):
        if has_slot(letter):
            for inner, factor in moments(letter).items():
                add_multiple(words, (*context[:k], inner, *context[k + 1 :]), factor)
    return words


class Spanned:
    """Contexts and letters, some of which span all places.

    `places` are the stages or flows where some contexts and some letters aren't zero for all
    coefficients; `contexts` and `columns` are indices into the pairing. `combinations` are the
    vectors of U_0, each the context that it is named by plus multiples of others. The vectors
    `first` of U_0 and the columns `second` are independent; `us` and `vs` are the others.
    """

    def __init__(
        self, pairing: Pairing, places: list[int], contexts: list[int], columns: list[int],
        second: list[int],
    ) -> None:  # fmt: skip
        self.pairing, self.places = pairing, places
        self.contexts, self.columns, self.second = contexts, columns, second
        self.vs = [j for j in columns if j not in second]

        def exact(i: int, j: int) -> flint.fmpq:
            terms = (reciprocal_density(word) * m for word, m in pairing.words(i, j).items())
            return to_flint(sum(terms, start=Fraction(0)))

        products = flint.fmpq_mat([[exact(i, j) for i in contexts] for j in columns])
        reduced, rank = products.rref()
        rows = reduced.tolist()[:rank]
        pivots = [next(k for k, entry in enumerate(row) if entry != 0) for row in rows]
        self.combinations = {}
        for k, i in enumerate(contexts):
            if k not in pivots:
                shares = [(p, -row[k]) for p, row in zip(pivots, rows, strict=True) if row[k] != 0]
                self.combinations[i] = {i: flint.arb(1)}
                self.combinations[i] |= {contexts[p]: flint.arb(share) for p, share in shares}
        names = list(self.combinations)
        vectors = doubles(map(self.left, names)).reshape(-1, len(places))
        self.first = [names[k] for k in independent_rows(vectors)]
        self.us = [i for i in names if i not in self.first]

    @property
    def complete(self) -> bool:
        """Whether the independent vectors fill all places, and there are others in U_0."""
        return len(self.first) + len(self.second) == len(self.places) and bool(self.us)

    def right(self, column: int) -> list[flint.arb]:
        """Return a letter's vector."""
        vector = self.pairing.right[column]
        return [vector[j] for j in self.places]

    def left(self, name: int) -> list[flint.arb]:
        """Return a vector of U_0."""
        terms = [(share, self.pairing.left[i]) for i, share in self.combinations[name].items()]
        return [sum((x * vector[j] for x, vector in terms), flint.arb(0)) for j in self.places]

    @cached_property
    def shares(self) -> tuple[list[Vector], list[Vector]]:
        """The δ of each of `us`, and the β of each of `vs`, then its γ.

        ZeroDivisionError if the independent vectors aren't proved to be so.
        """
        first, second = list(map(self.left, self.first)), list(map(self.right, self.second))
        both = flint.arb_mat([*second, *first]).transpose()
        others = flint.arb_mat(list(map(self.right, self.vs)))
        beta = both.solve(others.transpose()).transpose().tolist()
        if not first:
            return [[] for _ in self.us], beta
        rows = flint.arb_mat(first)
        products = rows * flint.arb_mat(list(map(self.left, self.us))).transpose()
        return (rows * rows.transpose()).solve(products).transpose().tolist(), beta

    def sides(self, m: int, n: int) -> tuple[dict[int, flint.arb], dict[int, flint.arb]]:
        """Return u - Σ δ_i u_i and v - Σ β_j v_j of one of `us` and one of `vs`."""
        delta, beta = self.shares
        u: dict[int, flint.arb] = {}
        shares = [flint.arb(1), *(-share for share in delta[m])]
        for name, factor in zip([self.us[m], *self.first], shares, strict=True):
            for i, share in self.combinations[name].items():
                add_multiple(u, i, factor * share)
        others = zip(self.second, beta[n], strict=False)
        return u, {self.vs[n]: flint.arb(1)} | {j: -share for j, share in others}


def independent_rows(rows: _Doubles) -> list[int]:
    """Return the indices of as many rows as are independent."""
    sizes = np.linalg.norm(rows, axis=1)
    kept = np.flatnonzero(sizes > _DEPENDENT * max(1.0, float(sizes.max(initial=0))))
    if not kept.size:
        return []
    units = rows[kept] / sizes[kept, None]
    triangle, pivots = linalg.qr(units.T, mode="r", pivoting=True)
    rank = int(np.sum(np.abs(np.diag(triangle)) > _DEPENDENT))
    return sorted(kept[pivots[:rank]].tolist())
