"""Words with a hole: what surrounds a stage, as a vector over the stages.

Letters are values at stages; a word with a hole at the place of a letter is linear in them.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from .relations import HOLE
from .words import Word, add_multiple, shuffle, words_with

__all__ = ["HOLE", "basis", "depth", "has_hole", "moments", "outer_nodes"]


@cache
def basis(order: int) -> tuple[Word, ...]:
    """Return words with a hole, and with up to so many nodes around it.

    The others follow by shuffles: at the root, the hole is in the last letter.
    """
    return tuple(h for count in range(1, order + 1) for h in _with_hole(count, last=True))


@cache
def _with_hole(count: int, last: bool) -> tuple[Word, ...]:
    found: list[Word] = []
    for inside in range(count + 1):
        # the letter with the hole, and words before and after it
        letters = [HOLE] if inside == 0 else list(_with_hole(inside - 1, last=False))
        for before in range(count - inside + 1):
            after = count - inside - before
            if after and last:
                continue
            found += [
                (*left, letter, *right)
                for letter in letters
                for left in words_with(before)
                for right in words_with(after)
            ]
    return tuple(found)


@cache
def outer_nodes(hole: Word) -> int:
    """Return how many nodes are around the hole."""
    return sum(0 if t == HOLE else 1 + outer_nodes(t) for t in hole)


def depth(word: Word) -> int:
    """Return how many letters are around the hole, or the depth of a word without one."""
    if HOLE in word:
        return 0
    inner = [t for t in word if has_hole(t)]
    return 1 + max(map(depth, inner or word), default=-1)


def has_hole(letter: Any) -> bool:
    """Tell whether a letter has the hole somewhere within it."""
    return letter != HOLE and any(t == HOLE or has_hole(t) for t in letter)


@cache
def moments(hole: Word) -> dict[Word, int]:
    """Return the words with a hole that integrate the moments of what is put into this one.

    The moments of v, along the path that the hole is on, are the integral of s dv where s is
    the weight of τ up to there: ``s v`` less the integral of v. Integrated by parts, a word
    ``p * q`` of it is ``(τ ⧢ p) * q`` less all ``p' * p'' τ q`` with ``p = p' p''``.
    """
    found: dict[Word, int] = {}

    if HOLE in hole:
        place = hole.index(HOLE)
        before, after = hole[:place], hole[place + 1 :]
        for word, multiplicity in shuffle(((),), before).items():
            add_multiple(found, (*word, HOLE, *after), multiplicity)
        for cut in range(place + 1):
            add_multiple(found, (*before[:cut], HOLE, *before[cut:], (), *after), -1)
    for k, letter in enumerate(hole):
        if has_hole(letter):
            for inner, factor in moments(letter).items():
                add_multiple(found, (*hole[:k], inner, *hole[k + 1 :]), factor)
    return found
