"""Weights of words along the rows of a tableau, and their derivatives, in ball arithmetic.

The same recursions as in the compiled core, on numbers of python-flint: balls (``arb``)
for proofs, rationals (``fmpq``) for exact weights without derivatives. A row acts on
words as the ordered product of the exponentials of its entries, so that a word is cut in
all ways into parts for earlier stages, for one stage, and for later ones.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import comb
from typing import Any, NamedTuple

from flint import arb, arb_mat

from ..layout import Layout, Rows
from .words import Letter, Word, closure, nodes

__all__ = ["Quantity", "Shape", "Weights"]

Vector = list[Any]

_CHUNK = 128  # quantities that are derived at a time: bounds the memory


class Quantity(NamedTuple):
    """The weight of a word along a row.

    Attributes
    ----------
    row : int
        From 0: the rows of a, then b, then the embedded weights.
    word : Word
    stop : int or None
        Only the first so many entries of the row count; None for all.
    """

    row: int
    word: Word
    stop: int | None = None


@dataclass(frozen=True)
class Shape:
    """Which unknowns a tableau has, packed row by row.

    Attributes
    ----------
    stages : int
    rows : Rows
    pair : bool
        Whether there is a second row of weights, last.
    """

    stages: int
    rows: Rows
    pair: bool = False

    @property
    def lengths(self) -> tuple[int, ...]:
        """Entries of each row."""
        layout = Layout.tableau(self.stages, self.rows, self.pair)
        return tuple(len(layout.row(r)) for r in range(len(layout.ends)))

    @property
    def starts(self) -> tuple[int, ...]:
        """Index of the first unknown of each row, and their number last."""
        starts = [0]
        for length in self.lengths:
            starts.append(starts[-1] + length)
        return tuple(starts)

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return self.starts[-1]

    def names(self) -> list[str]:
        """Return the names of the unknowns: ``a_3,1``, ``b_2``, ``b_embedded_2``."""
        labels = [f"a_{r}," for r in range(1, self.stages + 1)] + ["b_", "b_embedded_"]
        return [
            f"{labels[r]}{j}" for r, length in enumerate(self.lengths) for j in range(1, length + 1)
        ]


class _Row:
    """One row: exponentials and products of the stages to the left, for each word."""

    def __init__(self, entries: Vector, one: Any) -> None:
        self.entries = entries
        self.one = one
        self.exponential: dict[Word, Vector] = {(): [one] * len(entries)}
        self.left: dict[Word, Vector] = {(): [one] * len(entries)}
        self.total: dict[Word, Any] = {(): one}
        self.letters: dict[Letter, Vector] = {}

    def add(self, word: Word, letter: Sequence[Any]) -> None:
        """Compute a word whose proper factors are known; `letter` are the Φ_j of its first."""
        first = word[0]
        if first not in self.letters:
            pairs = zip(self.entries, letter, strict=False)
            self.letters[first] = [entry * phi for entry, phi in pairs]
        count = len(word)
        rest = self.exponential[word[1:]]
        e = [x * y / count for x, y in zip(rest, self.letters[first], strict=True)]
        self.exponential[word] = e
        change = self._cut(word, e, self.left, self.exponential)
        left, total = [], self.one * 0
        for part in change:
            left.append(total)
            total = total + part
        self.left[word], self.total[word] = left, total

    def right(self, words: Iterable[Word], stop: int) -> dict[Word, Vector]:
        """Return the products of the stages to the right, of the first `stop` ones."""
        found: dict[Word, Vector] = {(): [self.one] * stop}
        for word in words:
            change = self._cut(word, self.exponential[word], self.exponential, found)
            right, total = [], self.one * 0
            for k in range(stop - 1, -1, -1):
                right.append(total)
                total = total + change[k]
            found[word] = right[::-1]
        return found

    def up_to(self, word: Word, stop: int | None) -> Any:
        """Return the weight of a word along the first `stop` entries."""
        if stop is None or stop >= len(self.entries):
            return self.total[word]
        return self.left[word][stop]

    @staticmethod
    def _cut(word: Word, e: Vector, heads: dict[Word, Vector], tails: dict[Word, Vector]) -> Vector:
        change = e
        for cut in range(1, len(word)):
            parts = zip(change, heads[word[:cut]], tails[word[cut:]], strict=False)
            change = [c + h * t for c, h, t in parts]
        return change

    def slot(self, word: Word, m: int, right: dict[Word, Vector]) -> Vector:
        """Return the derivatives of the weight by ``entry_j Φ_j`` of the letter at place m."""
        stop = len(right[()])
        z: Vector | None = None
        for p in range(m + 1):
            earlier = _product(self.left[word[: m - p]], self.exponential[word[m - p : m]], stop)
            for q in range(len(word) - m):
                tail = m + 1 + q
                later = _product(self.exponential[word[m + 1 : tail]], right[word[tail:]], stop)
                share = (p + q + 1) * comb(p + q, p)  # (p + q + 1)! / (p! q!)
                if z is None:
                    z = [a * b / share for a, b in zip(earlier, later, strict=True)]
                else:
                    z = [c + a * b / share for c, a, b in zip(z, earlier, later, strict=True)]
        assert z is not None
        return z


def _product(u: Vector, v: Vector, stop: int) -> Vector:
    return [x * y for x, y in zip(u[:stop], v[:stop], strict=True)]


class Weights:
    """Weights of words along the rows of a tableau.

    Parameters
    ----------
    shape : Shape
    quantities : sequence of Quantity
        What to evaluate.
    """

    def __init__(self, shape: Shape, quantities: Sequence[Quantity]) -> None:
        self.shape = shape
        self.quantities = list(quantities)
        stages = shape.stages
        letters: set[Word] = set()
        wanted: dict[int, set[Word]] = {}
        for row, word, _ in self.quantities:
            wanted.setdefault(row, set()).add(word)
            letters.update(t for t in word if not isinstance(t, int) and t)
        inner = letters.union(*(words for row, words in wanted.items() if row < stages))
        self._stage_words = closure(inner)
        self._stage_trees = self._letters_of(self._stage_words, letters)
        self._outer = {row: list(closure(words)) for row, words in wanted.items() if row >= stages}

    @staticmethod
    def _letters_of(words: Iterable[Word], letters: set[Word]) -> list[Word]:
        found = set(letters)
        for word in words:
            found.update(t for t in word if not isinstance(t, int) and t)
        return sorted(found, key=nodes)

    def evaluate(self, x: Sequence[Any]) -> Vector:
        """Return the weights at packed entries, all ``arb`` or all ``fmpq``."""
        shape, starts = self.shape, self.shape.starts
        one = x[0] * 0 + 1
        self._one = one
        self._rows = [_Row(list(x[begin:end]), one) for begin, end in itertools.pairwise(starts)]
        self._phi: dict[Letter, Vector] = {(): [one] * shape.stages}
        for word in self._stage_words:
            letter = self._letter(word[0])
            for row in self._rows[: shape.stages]:
                row.add(word, letter)
            self._phi[word] = [row.total[word] for row in self._rows[: shape.stages]]
        for r, words in self._outer.items():
            for word in words:
                if word not in self._rows[r].total:
                    self._rows[r].add(word, self._letter(word[0]))
        return [self._rows[row].up_to(word, stop) for row, word, stop in self.quantities]

    def _letter(self, letter: Letter) -> Vector:
        if isinstance(letter, int) and letter not in self._phi:
            zero = self._one * 0
            self._phi[letter] = [
                self._one if j == letter else zero for j in range(self.shape.stages)
            ]
        return self._phi[letter]

    def jacobian(self) -> arb_mat:
        """Return the derivatives of the quantities, after `evaluate` on balls.

        Returns
        -------
        arb_mat, shape (quantities, unknowns)
        """
        stages = self.shape.stages
        rows = self._rows[:stages]
        rights = [row.right(self._stage_words, len(row.entries)) for row in rows]
        # per tree: derivatives by the weights of its letters, and by the entries themselves
        self._inner: dict[Word, list[tuple[Letter, arb_mat]]] = {}
        self._direct: dict[Word, list[Vector]] = {}
        for tree in self._stage_trees:
            slots = [
                [row.slot(tree, m, right) for row, right in zip(rows, rights, strict=True)]
                for m in range(len(tree))
            ]
            phis = [self._letter(letter) for letter in tree]
            self._direct[tree] = [
                _combine(phis, [slot[r] for slot in slots]) for r in range(stages)
            ]
            self._inner[tree] = [
                (letter, self._square(slot))
                for letter, slot in zip(tree, slots, strict=True)
                if letter != () and not isinstance(letter, int)
            ]
        blocks: list[Vector] = []
        for begin in range(0, len(self.quantities), _CHUNK):
            blocks += self._derive(self.quantities[begin : begin + _CHUNK])
        return arb_mat(blocks)

    def _square(self, slot: list[Vector]) -> arb_mat:
        stages = self.shape.stages
        zero = arb(0)
        entries: Vector = []
        for row, z in zip(self._rows, slot, strict=False):
            entries += [x * y for x, y in zip(row.entries, z, strict=True)]
            entries += [zero] * (stages - len(z))
        return arb_mat(stages, stages, entries)

    def _derive(self, quantities: list[Quantity]) -> list[Vector]:
        count, stages, starts = len(quantities), self.shape.stages, self.shape.starts
        zero = arb(0)
        own = [[zero] * self.shape.unknowns for _ in range(count)]
        seeds: dict[Word, dict[int, Vector]] = {}
        rights: dict[tuple[int, int], dict[Word, Vector]] = {}
        for c, (r, word, stop) in enumerate(quantities):
            row = self._rows[r]
            length = len(row.entries) if stop is None else min(stop, len(row.entries))
            if (r, length) not in rights:
                words = self._outer.get(r, self._stage_words)
                rights[r, length] = row.right(words, length)
            for m, letter in enumerate(word):
                z = row.slot(word, m, rights[r, length])
                for j, (y, phi) in enumerate(zip(z, self._letter(letter), strict=False), starts[r]):
                    own[c][j] = own[c][j] + y * phi
                if letter != () and not isinstance(letter, int):
                    seed = seeds.setdefault(letter, {}).setdefault(c, [zero] * stages)
                    for j, (y, x) in enumerate(zip(z, row.entries, strict=False)):
                        seed[j] = seed[j] + y * x
        return self._sweep(own, seeds)

    def _sweep(self, own: list[Vector], seeds: dict[Word, dict[int, Vector]]) -> list[Vector]:
        """Carry derivatives by the weights of trees down to trees with fewer nodes."""
        count, stages = len(own), self.shape.stages
        empty = [arb(0)] * stages
        adjoints: dict[Word, arb_mat] = {
            tree: arb_mat([found.get(c, empty) for c in range(count)])
            for tree, found in seeds.items()
        }
        columns: dict[Word, Vector] = {}
        for tree in reversed(self._stage_trees):
            if tree not in adjoints:
                continue
            adjoint = adjoints.pop(tree)
            columns[tree] = adjoint.entries()
            for letter, square in self._inner[tree]:
                change = adjoint * square
                adjoints[letter] = adjoints[letter] + change if letter in adjoints else change
        trees = list(columns)
        for r in range(stages):
            begin, end = self.shape.starts[r : r + 2]
            if begin == end or not trees:
                continue
            by_weight = arb_mat([columns[tree][r::stages] for tree in trees]).transpose()
            block = (by_weight * arb_mat([self._direct[tree][r] for tree in trees])).entries()
            for c in range(count):
                part = block[c * (end - begin) : (c + 1) * (end - begin)]
                own[c][begin:end] = [x + y for x, y in zip(own[c][begin:end], part, strict=True)]
        return own


def _combine(phis: list[Vector], slots: list[Vector]) -> Vector:
    total = [phi * z for phi, z in zip(phis[0], slots[0], strict=False)]
    for letter, slot in zip(phis[1:], slots[1:], strict=True):
        total = [t + phi * z for t, phi, z in zip(total, letter, slot, strict=False)]
    return total
