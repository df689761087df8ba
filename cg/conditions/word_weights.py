"""Weights of words at the points of a method, and their derivatives, in ball arithmetic.

With the letters l_m(v) = Σ_k y_mk Φ_k(v) of the flow to point m, its exponential E_m and the
weights χ_m at the point,

    E_m(w) = l_m(w_1) … l_m(w_n) / n!,   χ_m(w) = Σ_{w = u v} χ_parent(u) E_m(v),

as in ``fortran/conditions/weights.f90``: `_letter`, `_flow` and `_chi`. Compiled code has no balls;
the numbers here are those of python-flint, ``arb`` for proofs and ``fmpq`` for exact weights.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import comb
from typing import Any, NamedTuple

from cg.conditions.words import Word, closure, nodes
from cg.layouts.layout import Layout
from cg.layouts.points import START
from cg.support import flint

Vector = list[Any]

_CHUNK = 128  # quantities that are derived at a time: bounds the memory


class Quantity(NamedTuple):
    """The weight of a word at the end of a row: from 0 the stages, then one or two results."""

    row: int
    word: Word


class _Segment(NamedTuple):
    """Points that follow each other, of which only the last has stages or several children."""

    points: list[int]
    origin: int  # the segment at whose end it begins, -1 for the start


def _segments(layout: Layout) -> list[_Segment]:
    """Return the segments on the paths to the stages, parents first."""
    inner = sorted({m for at in layout.stage_points for m in layout.path(at)})
    children = [m for m in inner if layout.parents[m] != START]
    branches = [layout.parents[m] for m in children]
    ends = {*layout.stage_points, *(p for p in branches if branches.count(p) > 1)}
    segments: list[_Segment] = []
    belongs = {START: START}
    for m in inner:
        parent = layout.parents[m]
        if parent == START or parent in ends:
            belongs[m] = len(segments)
            segments.append(_Segment([m], belongs[parent]))
        else:
            belongs[m] = belongs[parent]
            segments[belongs[m]].points.append(m)
    return segments


class Weights:
    """Weights of words at points of a method: evaluation of `quantities`, and their derivatives."""

    def __init__(self, layout: Layout, quantities: Sequence[Quantity]) -> None:
        self.layout = layout
        self.quantities = list(quantities)
        self._paths = [layout.path(layout.ends[quantity.row]) for quantity in self.quantities]
        letters: set[Word] = set()
        words: set[Word] = set()
        for (row, word), path in zip(self.quantities, self._paths, strict=True):
            letters.update(filter(None, word))
            if row < layout.stages or not path:
                words.add(word)
        self._segments = _segments(layout)
        self._stage_words = closure(letters | words)
        within = (filter(None, word) for word in self._stage_words)
        self._letters = sorted(letters.union(*within), key=nodes)
        # by word, the points where it is needed
        everywhere = [m for segment in self._segments for m in segment.points]
        needed = {word: set(everywhere) for word in self._stage_words}
        self._outer: dict[int, list[Word]] = {}
        words_at: dict[int, set[Word]] = {}
        for quantity, path in zip(self.quantities, self._paths, strict=True):
            if path:
                words_at.setdefault(path[-1], set()).add(quantity.word)
        for end, result_words in words_at.items():
            self._outer[end] = closure(result_words)
            for word in self._outer[end]:
                needed.setdefault(word, set()).update(layout.path(end))
        self._needed = {word: sorted(needed[word]) for word in sorted(needed, key=nodes)}

    def evaluate(self, x: Sequence[Any]) -> Vector:
        """Return the weights at packed unknowns, all ``arb`` or all ``fmpq``."""
        layout = self.layout
        points = len(layout.parents)
        self._x = list(x)
        self._rights: dict[int, dict[Word, Vector]] = {}
        self._one = one = x[0] * 0 + 1
        self._zero = zero = one * 0
        self._phi: dict[Word, Vector] = {(): [one] * layout.stages}
        self._letter: dict[Word, Vector] = {}
        # by word: of the flow alone, at the parent, and at the point; the start is last
        self._flow: dict[Word, Vector] = {(): [one] * points}
        self._left: dict[Word, Vector] = {(): [one] * points}
        self._chi: dict[Word, Vector] = {(): [one] * (points + 1)}
        stage_words = set(self._stage_words)
        for word, where in self._needed.items():
            self._add(word, where)
            if word in stage_words:
                chi = self._chi[word]
                self._phi[word] = [chi[at] for at in layout.stage_points]
        return [
            self._chi[quantity.word][path[-1]] if path else (zero if quantity.word else one)
            for quantity, path in zip(self.quantities, self._paths, strict=True)
        ]

    def _add(self, word: Word, where: Sequence[int]) -> None:
        """Compute a word whose proper factors are known, at some points with their parents."""
        count, points = len(word), len(self.layout.parents)
        rest, letter = self._flow[word[1:]], self._letter_at_points(word[0])
        flow: Vector = [None] * points
        left: Vector = [None] * points
        chi: Vector = [None] * points + [self._zero]
        cuts = [(self._left[word[:cut]], self._flow[word[cut:]]) for cut in range(1, count)]
        parents = self.layout.parents
        for m in where:
            change = flow[m] = rest[m] * letter[m] / count
            for head, tail in cuts:
                change = change + head[m] * tail[m]
            left[m] = chi[parents[m]]
            chi[m] = left[m] + change
        self._flow[word], self._left[word], self._chi[word] = flow, left, chi

    def _letter_at_points(self, letter: Word) -> Vector:
        """Return the combinations of a letter's values that the flows to points have."""
        if letter not in self._letter:
            phi, layout = self._phi[letter], self.layout
            values: Vector = []
            for begin, stages in zip(layout.starts, layout.weights, strict=False):
                terms = [self._x[k] * phi[stage] for k, stage in enumerate(stages, begin)]
                values.append(sum(terms[1:], start=terms[0]) if terms else self._zero)
            self._letter[letter] = values
        return self._letter[letter]

    def _right(
        self, words: Iterable[Word], path: Sequence[int]
    ) -> tuple[dict[Word, Vector], dict[Word, Any]]:
        """Return the products of the flows after each point of a path, and of all of them."""
        products: dict[Word, Vector] = {(): [self._one] * len(path)}
        whole: dict[Word, Any] = {(): self._one}
        for word in words:
            flow = self._flow[word]
            cuts = [(self._flow[word[:cut]], products[word[cut:]]) for cut in range(1, len(word))]
            right, total = [], self._zero
            for i in range(len(path) - 1, -1, -1):
                m = path[i]
                right.append(total)
                total = total + flow[m]
                for head, tail in cuts:
                    total = total + head[m] * tail[i]
            products[word], whole[word] = right[::-1], total
        return products, whole

    def _slopes_at(
        self, word: Word, m: int, path: Sequence[int], right: dict[Word, Vector]
    ) -> Vector:
        """Return the derivatives of the weight by the letters of points at place m."""
        z: Vector | None = None
        for p in range(m + 1):
            left, flow = self._left[word[: m - p]], self._flow[word[m - p : m]]
            earlier = [left[i] * flow[i] for i in path]
            for q in range(len(word) - m):
                tail = m + 1 + q
                after, beyond = self._flow[word[m + 1 : tail]], right[word[tail:]]
                later = [after[i] * b for i, b in zip(path, beyond, strict=True)]
                share = (p + q + 1) * comb(p + q, p)  # (p + q + 1)! / (p! q!)
                if z is None:
                    z = [a * b / share for a, b in zip(earlier, later, strict=True)]
                else:
                    z = [c + a * b / share for c, a, b in zip(z, earlier, later, strict=True)]
        assert z is not None
        return z

    def slopes(self, row: int, before: Word, after: Word) -> Vector:
        """Return the derivatives of a row's weight by a letter's values on the flows to all points.

        The letter stands between the words `before` and `after`; evaluate the row with them first.
        """
        path = self.layout.path(self.layout.ends[row])
        slopes = [self._zero] * len(self.layout.parents)
        if path:
            z = self._slopes_at((*before, (), *after), len(before), path, self._right_of(path))
            for point, slope in zip(path, z, strict=True):
                slopes[point] = slope
        return slopes

    def _right_of(self, path: list[int]) -> dict[Word, Vector]:
        """Return the products of the flows after each point of a path, to its end."""
        end = path[-1]
        if end not in self._rights:
            self._rights[end] = self._right(self._outer.get(end, self._stage_words), path)[0]
        return self._rights[end]

    def jacobian(self) -> flint.arb_mat:
        """Return the derivatives of the quantities in balls, shape (quantities, unknowns).

        Adjoints of weights at the ends of segments are carried from words with many nodes to those
        with few, as in ``fortran/conditions/gradient.f90``.
        """
        layout, segments = self.layout, self._segments
        end_of = {segment.points[-1]: s for s, segment in enumerate(segments)}
        # by stage: the segment at whose end it is
        self._segment_of = [end_of.get(at, START) for at in layout.stage_points]
        self._branched = any(segment.origin != START for segment in segments)
        self._steps: dict[Word, list[tuple[Word, flint.arb_mat]]] = {}
        self._direct: dict[Word, list[Vector]] = {}
        products = [self._right(self._stage_words, segment.points) for segment in segments]
        self._wholes_ = [whole for _, whole in products]
        # words before others matter only where segments begin at others
        words = self._stage_words if self._branched else self._letters
        self._swept = sorted(words, key=nodes)
        for word in self._swept:
            self._add_steps(word, [right for right, _ in products])
        blocks: list[Vector] = []
        for begin in range(0, len(self.quantities), _CHUNK):
            blocks += self._derive(range(len(self.quantities))[begin : begin + _CHUNK])
        return flint.arb_mat(blocks)

    def _add_steps(self, word: Word, rights: Sequence[dict[Word, Vector]]) -> None:
        """Store the derivatives of a word by weights, by its letters, and by its prefixes."""
        segments, size = self._segments, len(self._segments)
        direct = [[self._zero] * len(self._unknowns(segment.points)) for segment in segments]
        steps: list[tuple[Word, flint.arb_mat]] = []
        for m, letter in enumerate(word):
            table = [[self._zero] * size for _ in segments]
            for s, (segment, right) in enumerate(zip(segments, rights, strict=True)):
                z = self._slopes_at(word, m, segment.points, right)
                self._add_terms(letter, segment.points, z, direct[s], table[s])
            if letter:
                steps.append((letter, flint.arb_mat(table) if size else flint.arb_mat(0, 0)))
        if self._branched:
            for cut in range(1, len(word)):
                table = [[self._zero] * size for _ in segments]
                for s, segment in enumerate(segments):
                    if segment.origin != START:
                        table[s][segment.origin] = self._wholes_[s][word[cut:]]
                steps.append((word[:cut], flint.arb_mat(table)))
        self._direct[word], self._steps[word] = direct, steps

    def _add_terms(
        self, letter: Word, points: Sequence[int], z: Vector, direct: Vector, table: Vector
    ) -> None:
        """Add the derivatives z by a letter at points to those by unknowns, and at segments."""
        terms = zip(points, z, strict=True)
        unknowns = [(k, stage, y) for m, y in terms for k, stage in self._point_unknowns(m)]
        for i, (k, stage, y) in enumerate(unknowns):
            direct[i] = direct[i] + y * self._phi[letter][stage]
            at = self._segment_of[stage]
            if at != START:
                table[at] = table[at] + y * self._x[k]

    def _point_unknowns(self, point: int) -> Iterable[tuple[int, int]]:
        """Return the unknowns of a point, each with its stage."""
        return enumerate(self.layout.weights[point], self.layout.starts[point])

    def _unknowns(self, points: Sequence[int]) -> list[int]:
        return [k for point in points for k, _ in self._point_unknowns(point)]

    def _derive(self, chosen: Sequence[int]) -> list[Vector]:
        count, size = len(chosen), len(self._segments)
        slopes = [[self._zero] * self.layout.size for _ in range(count)]
        seeds: dict[Word, dict[int, Vector]] = {}
        for c, index in enumerate(chosen):
            word, path = self.quantities[index].word, self._paths[index]
            if not path:
                continue
            right, unknowns = self._right_of(path), self._unknowns(path)
            stages = {stage for point in path for _, stage in self._point_unknowns(point)}
            reaches = any(self._segment_of[stage] != START for stage in stages)
            for m, letter in enumerate(word):
                direct, seed = [slopes[c][k] for k in unknowns], [self._zero] * size
                if letter and reaches:
                    seed = seeds.setdefault(letter, {}).setdefault(c, seed)
                self._add_terms(letter, path, self._slopes_at(word, m, path, right), direct, seed)
                for k, slope in zip(unknowns, direct, strict=True):
                    slopes[c][k] = slope
        return self._sweep(slopes, seeds)

    def _sweep(self, slopes: list[Vector], seeds: dict[Word, dict[int, Vector]]) -> list[Vector]:
        """Carry derivatives by the weights of words down to words with fewer nodes."""
        count, size = len(slopes), len(self._segments)
        empty = [self._zero] * size
        adjoints: dict[Word, flint.arb_mat] = {
            word: flint.arb_mat([rows.get(c, empty) for c in range(count)])
            for word, rows in seeds.items()
        }
        columns: dict[Word, Vector] = {}
        for word in reversed(self._swept):
            if word not in adjoints:
                continue
            adjoint = self._to_origins(adjoints.pop(word))
            columns[word] = adjoint.entries()
            for part, step in self._steps[word]:
                change = adjoint * step
                adjoints[part] = adjoints[part] + change if part in adjoints else change
        words = list(columns)
        for s, segment in enumerate(self._segments):
            if not words:
                break
            unknowns = self._unknowns(segment.points)
            by_weight = flint.arb_mat([columns[word][s::size] for word in words]).transpose()
            block = (by_weight * flint.arb_mat([self._direct[word][s] for word in words])).entries()
            for c in range(count):
                changes = block[c * len(unknowns) : (c + 1) * len(unknowns)]
                for k, y in zip(unknowns, changes, strict=True):
                    slopes[c][k] = slopes[c][k] + y
        return slopes

    def _to_origins(self, adjoint: flint.arb_mat) -> flint.arb_mat:
        """Add the adjoints of segments that begin at the end of each segment."""
        if not self._branched:
            return adjoint
        rows = adjoint.tolist()
        for s in range(len(self._segments) - 1, -1, -1):
            origin = self._segments[s].origin
            if origin != START:
                for row in rows:
                    row[origin] = row[origin] + row[s]
        return flint.arb_mat(rows)
