"""Contexts: words with a slot, in place of a letter, which is filled with other letters.

The weight Φ(h(v)) of a context h filled with a letter v is linear in the values of v at the stages.
So a context is a vector, whose product with that of a letter is the weight of a word: conditions
become statements on vectors, which linear algebra relates (`orthogonality`).
"""

from functools import cache
from typing import Any

from cg.construction.conditions.words import Word, add_multiple, shuffle, words_with

SLOT: Any = -1  # where a letter was cut out of a word


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
        # the letter with the slot, and words before and after it
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


def depth(word: Word) -> int:
    """Return the number of letters around the slot, or the depth of a word without one."""
    if SLOT in word:
        return 0
    inner = [t for t in word if has_slot(t)]
    return 1 + max(map(depth, inner or word), default=-1)


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
        place = context.index(SLOT)
        before, after = context[:place], context[place + 1 :]
        for word, multiplicity in shuffle(((),), before).items():
            add_multiple(words, (*word, SLOT, *after), multiplicity)
        for cut in range(place + 1):
            add_multiple(words, (*before[:cut], SLOT, *before[cut:], (), *after), -1)
    for k, letter in enumerate(context):
        if has_slot(letter):
            for inner, factor in moments(letter).items():
                add_multiple(words, (*context[:k], inner, *context[k + 1 :]), factor)
    return words
