"""Identities and structures by which order conditions depend on others, and their names."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from fractions import Fraction
from functools import partial
from itertools import combinations
from typing import NamedTuple

from ..structure.layout import Layout, Rows
from ..support.parsing import read_fraction
from .dependent.composition import MidpointSteps
from .dependent.flat_tableau import FlatTableau
from .dependent.identities import MiddleAbscissae, StageOrderTwo
from .dependent.orthogonality import Condition, conditions_of
from .dependent.path import PathStructure
from .dependent.registers import TwoRegisters
from .dependent.relations import Identity, kept_words
from .dependent.structure import MethodStructure
from .dependent.time_symmetry import TimeSymmetry
from .dependent.words import parse, text
from .systems import Equation, EquationSystem, condition, nearly_satisfied

_ORTHOGONAL = "orthogonality"
_SMALL_ONLY = "only small, below"

MAX_SMALL = Fraction(1, 10**40)
"""Larger bounds don't tell conditions that hold from coefficients that are rounded."""

STRUCTURES: dict[str, Callable[..., MethodStructure]] = {
    "flat tableau": FlatTableau,
    "flat tableau in Q(√21)": partial(FlatTableau, root=21),
    "two registers": TwoRegisters,
    "time symmetry": TimeSymmetry,
    "path": PathStructure,
    "path of order two": partial(PathStructure, infinite=True),
}
"""Structures by their names in certificates."""


def read_identity(name: str) -> Identity:
    """Return the identity with a name; ValueError if there is none."""
    if stage := re.fullmatch(r"C\(2\) except at stage ([1-9]\d*)", name):
        return StageOrderTwo(int(stage[1]) - 1)
    for identity in (MidpointSteps(), MiddleAbscissae(), MiddleAbscissae(first_only=True)):
        if identity.name == name:
            return identity
    raise ValueError(f"there is no identity named {name!r}")


def find_identities(
    layout: Layout, x: Sequence[Fraction], zeros: Sequence[Collection[int]]
) -> Iterator[tuple[Identity, ...]]:
    """Yield the sets of identities that packed coefficients satisfy nearly, small sets first.

    There are none for trees of points. `zeros` has the stages, from 0, where each row of weights is
    held at zero.
    """
    if layout.rows is None:
        return
    candidates: list[Identity] = [*map(StageOrderTwo, range(layout.stages)), MiddleAbscissae()]
    if layout.pair:
        candidates.append(MiddleAbscissae(first_only=True))
    elif layout.rows is Rows.DIAGONAL:
        candidates.insert(0, MidpointSteps())
    satisfied = [
        identity
        for identity in candidates
        if (equations := identity.equations(layout, zeros))
        and nearly_satisfied(layout, equations, x)
    ]
    for size in range(1, len(satisfied) + 1):
        yield from combinations(satisfied, size)


class LeftOut(NamedTuple):
    """Conditions that are no equations of a certificate.

    They follow by orthogonality and by the relations of a structure, if `structure` names one; with
    a decimal `bound` they are only shown to be smaller.
    """

    conditions: Sequence[Condition] = ()
    structure: str = ""
    bound: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The texts in certificates, for `read_left_out`."""
        trees = " ".join(f"{row * '*'}{text(word)}" for row, word in self.conditions)
        if self.bound:
            return (f"{_SMALL_ONLY} {self.bound}: {trees}",)
        return (*filter(None, [self.structure]), f"{_ORTHOGONAL}: {trees}")


def read_left_out(names: Sequence[str]) -> LeftOut:
    """Return the conditions that the texts of a certificate leave out, none for other identities.

    ValueError, TypeError or ZeroDivisionError if a tree or a bound can't be read, or the bound is
    too large.
    """
    structure = names[0] if names and names[0] in STRUCTURES else ""
    rest = list(names[bool(structure) :])
    heading, _, trees = rest[0].partition(": ") if rest else ("", "", "")
    bound = heading.removeprefix(_SMALL_ONLY).strip() if heading.startswith(_SMALL_ONLY) else ""
    if bound and (len(names) > 1 or not 0 < read_fraction(bound) <= MAX_SMALL):
        raise ValueError("conditions that are only small need a small bound, and nothing else")
    if not bound and (len(rest) != 1 or heading != _ORTHOGONAL):
        return LeftOut()
    words = [(int(tree.startswith("*")), parse(tree.removeprefix("*"))) for tree in trees.split()]
    return LeftOut(words, structure, bound)


def _labelled(word: Condition, layout: Layout) -> Equation:
    row, letters = word
    equation = condition(letters, layout.stages + row)
    return equation._replace(label=f"{equation.label} embedded") if row else equation


def reduced_system(
    layout: Layout,
    orders: Sequence[int],
    left_out: Sequence[Condition],
    more: Sequence[Equation] = (),
) -> EquationSystem:
    """Return the order conditions without those that are left out, and more equations.

    ValueError if something that is left out isn't an independent condition, or occurs twice.
    """
    conditions = conditions_of(orders, layout.of_time)
    omitted = set(left_out)
    if len(omitted) != len(left_out) or not omitted.issubset(conditions):
        raise ValueError("conditions that are left out must be distinct independent ones")
    equations = (_labelled(one, layout) for one in conditions if one not in omitted)
    return EquationSystem(layout, (*equations, *more))


def augmented_system(
    layout: Layout,
    orders: Sequence[int],
    identities: Sequence[Identity],
    zeros: Sequence[Collection[int]],
) -> EquationSystem:
    """Return identities as equations, with the conditions that don't follow by them.

    `orders` are those of b and of the second weights of a pair; `zeros` has for the same rows the
    stages, from 0, where weights are held at zero. ValueError if an identity doesn't fit the
    layout.
    """
    if identities and layout.rows is None:
        raise ValueError("identities are about tableaux")
    equations = [e for identity in identities for e in identity.equations(layout, zeros)]
    for r, (order, held) in enumerate(zip(orders, zeros, strict=True)):
        known = [one for one in identities if not (r and one.first_only)]
        for grade in range(1, order + 1):
            equations += [_labelled((r, word), layout) for word in kept_words(grade, known, held)]
    return EquationSystem(layout, tuple(equations))
