"""Words with a hole: what surrounds a stage, as a vector over the stages.

Letters are values at stages; a word with a hole at the place of a letter is linear in them. For
the exact solution it is an integral over [0, 1] of the letter times a polynomial.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import factorial

from flint import fmpq, fmpq_mat

from .relations import HOLE, fill
from .words import Word, parse, reciprocal_density, text

__all__ = ["basis", "outer_nodes", "polynomial", "read_hole", "write_hole"]


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
                for left in _words(before)
                for right in _words(after)
            ]
    return tuple(found)


@cache
def _words(count: int) -> tuple[Word, ...]:
    """Return all words with so many nodes."""
    if count == 0:
        return ((),)
    return tuple(
        (letter, *rest)
        for first in range(1, count + 1)
        for letter in _words(first - 1)
        for rest in _words(count - first)
    )


def outer_nodes(hole: Word) -> int:
    """Return how many nodes are around the hole."""
    return sum(0 if t == HOLE else 1 + outer_nodes(t) for t in hole)


@cache
def polynomial(hole: Word) -> tuple[Fraction, ...]:
    """Return the coefficients, from the constant on, by which the exact solution integrates.

    With the letter of k leaves in the hole, whose value is θ^k / k!, 1/γ is an integral over
    [0, 1]; so many of them determine the polynomial, of degree `outer_nodes`.
    """
    size = outer_nodes(hole) + 1
    moments = fmpq_mat(size, size, [fmpq(1, i + k + 1) for k in range(size) for i in range(size)])
    values = [factorial(k) * reciprocal_density(fill(hole, ((),) * k)) for k in range(size)]
    right = fmpq_mat(size, 1, [fmpq(v.numerator, v.denominator) for v in values])
    return tuple(Fraction(int(p.p), int(p.q)) for p in moments.solve(right).entries())


def write_hole(hole: Word) -> str:
    """Write a word as the tree with these children, a star for the hole."""
    return "[" + "".join("*" if t == HOLE else write_hole(t) for t in hole) + "]"


def read_hole(written: str) -> Word:
    """Read what `write_hole` writes; ValueError if it isn't that."""
    depth = written.count("[") + 1
    marked = "[" * depth + "]" * depth  # deeper than any tree in it
    tree = parse(written.replace("*", marked))

    def hollow(word: Word) -> Word:
        return tuple(HOLE if text(t) == marked else hollow(t) for t in word)

    if written.count("*") != 1:
        raise ValueError(f"no word with a hole is written {written!r}")
    return hollow(tree)
