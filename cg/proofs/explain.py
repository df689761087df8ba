"""Which identities a method satisfies, and the equations that then prove its order."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import combinations
from typing import Any, Protocol

import numpy as np
from flint import arb, arb_mat, fmpq
from numpy.typing import NDArray
from scipy import linalg

from ..structure.layout import Layout, Rows
from ..support.parsing import read_fraction
from ..support.quads import to_decimal
from .dependent.composition import MidpointSteps
from .dependent.flat_rows import FlatRows
from .dependent.identities import MiddleAbscissae, OfFirstWeights, PathOrderTwo, StageOrderTwo
from .dependent.orthogonality import Condition, Known, conditions_of
from .dependent.parametric import Columns, Letters, Path
from .dependent.registers import TwoRegisters
from .dependent.relations import Identity, kept_words
from .dependent.words import Word, condition_words, nodes, parse, reciprocal_density, text
from .krawczyk import to_double
from .systems import Equation, EquationSystem, condition
from .weights import Quantity, Weights

__all__ = [
    "MAX_SMALL",
    "STRUCTURES",
    "Structure",
    "augment",
    "find_identities",
    "name_of",
    "names_of_left_out",
    "names_of_small",
    "read_identity",
    "read_left_out",
    "read_small",
    "without",
]

_THRESHOLD = 1e-11  # singular values below this fraction of the largest count as zero
_SMALL = 1e-20  # what counts as zero when identities are looked for, not when they are proved
_DIGITS = 60  # of parameters
_ORTHOGONAL = "orthogonality:"
_SMALL_ONLY = "only small, below"

MAX_SMALL = Fraction(1, 10**40)
"""Larger bounds don't tell conditions that hold from coefficients that are rounded."""

STRUCTURES: dict[str, Callable[..., FlatRows | TwoRegisters]] = {
    "flat tableau": FlatRows,
    "flat tableau in Q(√21)": partial(FlatRows, root=21),
    "two registers": TwoRegisters,
}
"""What makes further conditions follow, if its equations are held, by name."""


class Structure(Protocol):
    """Something that a method has, whose equations make further conditions follow."""

    def satisfied(self) -> bool:
        """Tell whether the method has it, as far as its places can tell."""

    def equations(self) -> list[Equation]:
        """Return what is to be proved of the coefficients."""

    def relations(self) -> Iterator[Known]:
        """Return combinations of residuals that are zero then."""


def name_of(identity: Identity) -> str:
    """Write an identity with its parameters, for `read_identity`."""
    values = " ".join(to_decimal(value, _DIGITS) for value in identity.parameters)
    return f"{identity.heading}: {values}" if values else identity.heading


def read_identity(name: str) -> Identity:
    """Make an identity from its name.

    Raises
    ------
    ValueError
        If no such identity is known.
    """
    heading, _, values = name.partition(": ")
    parameters = tuple(map(read_fraction, values.split()))
    stage = re.fullmatch(r"C\(2\) except at stage ([1-9]\d*)", heading)
    found: Identity
    if stage and not parameters:
        found = StageOrderTwo(int(stage[1]) - 1)
    elif heading == "path" and len(parameters) == 1:
        found = Path(parameters)
    elif heading == "columns" and len(parameters) == 1:
        found = Columns(parameters)
    elif heading.startswith("letters "):
        found = Letters.read(heading, parameters)
    else:
        both: tuple[Identity, ...] = (MiddleAbscissae(), PathOrderTwo())
        plain = (MidpointSteps(), *both, *map(OfFirstWeights, both))
        found = next((one for one in plain if one.heading == heading), PathOrderTwo())
    if name_of(found) != name:
        raise ValueError(f"no identity is known as {name!r}")
    return found


def find_identities(
    layout: Layout, y: Sequence[arb], zeros: Sequence[Collection[int]]
) -> Iterator[tuple[Identity, ...]]:
    """Yield the sets of identities that coefficients seem to satisfy, small ones first.

    Parameters
    ----------
    layout : Layout
    y : sequence of arb
        Packed coefficients.
    zeros : sequence of collections of int
        For each row of weights, the stages (from 0) where they are held at zero.
    """
    if layout.rows is None:
        return  # they are about rows of tableaux; for trees of points see `orthogonality`
    found: list[tuple[Identity, ...]] = []
    for k in range(layout.stages):
        found += [(StageOrderTwo(k),)]
    found += [
        (MiddleAbscissae(),),
        (PathOrderTwo(),),
    ]
    if layout.pair:
        found += [(OfFirstWeights(MiddleAbscissae()),), (OfFirstWeights(PathOrderTwo()),)]
    found += [
        (Path((Fraction(0),)),),
        (Columns((Fraction(0),)),),
    ]
    if layout.rows is Rows.DIAGONAL and not layout.pair:
        found.insert(0, (MidpointSteps(),))
    letters = _dependent_letters(layout, y)
    if letters:
        found.append(letters)
    fitted = [
        kept
        for group in found
        if len(kept := [f for one in group if (f := _fit(one, layout, y, zeros))]) == len(group)
    ]
    for size in range(1, len(fitted) + 1):
        for chosen in combinations(fitted, size):
            yield tuple(one for group in chosen for one in group)


def _fit(
    identity: Identity, layout: Layout, y: Sequence[arb], zeros: Sequence[Collection[int]]
) -> Identity | None:
    """Return the identity with fitting parameters; None if it isn't satisfied, or undetermined."""
    count = len(identity.parameters)
    equations = identity.equations(layout, zeros, 0)
    if len(equations) <= count:
        return None
    system = EquationSystem(layout, tuple(equations), count)
    values, jacobian = system.linearise([*y, *[arb(0)] * count])
    found: list[arb] = []
    if count:
        rows = [row[layout.size :] for row in jacobian.tolist()]
        by_parameter = to_double(arb_mat(rows))
        factor, pivots = linalg.qr(by_parameter.T, mode="r", pivoting=True)
        diagonal = np.abs(np.diag(factor))
        if diagonal.min() <= _THRESHOLD * diagonal.max():
            return None
        chosen = [int(k) for k in pivots[:count]]
        right = arb_mat([[-values[k]] for k in chosen])
        found = arb_mat([rows[k] for k in chosen]).solve(right).entries()
        terms = [[entry * p for entry, p in zip(row, found, strict=True)] for row in rows]
        values = [value + sum(row, arb(0)) for value, row in zip(values, terms, strict=True)]
    if any(not abs(value) < _SMALL for value in values):
        return None
    if not count:
        return identity
    decimals = tuple(Fraction(to_decimal(_middle(p), _DIGITS)) for p in found)
    return replace(identity, parameters=decimals)  # type: ignore[type-var]


def _middle(value: arb) -> Fraction:
    mantissa, exponent = value.mid().man_exp()
    return int(mantissa) * Fraction(2) ** int(exponent)


def _dependent_letters(layout: Layout, y: Sequence[arb]) -> tuple[Letters, ...]:
    """Return the relations between trees with three or four nodes, without parameters."""
    words = [
        w for w in condition_words(3, independent=False) if nodes(w) > 1 and w != ((),) * nodes(w)
    ]
    vectors = _deviations(words, layout, y)
    scale = np.maximum(np.abs(vectors).max(axis=0), 1e-300)
    _, values, right = linalg.svd(vectors / scale)
    values = np.pad(values, (0, len(words) - len(values)))
    null = right[values <= _THRESHOLD * values[0]] / scale
    high = [k for k, word in enumerate(words) if nodes(word) == 3]
    count = len(null)
    if not count or count > len(high) or len(vectors) < len(words):
        return ()
    pivots = linalg.qr(null[:, high], mode="r", pivoting=True)[1][:count]
    chosen = [words[high[int(k)]] for k in pivots]
    others = tuple(word for word in words if word not in chosen)
    return tuple(Letters(word, others, (Fraction(0),) * len(others)) for word in chosen)


def _deviations(words: Sequence[Word], layout: Layout, y: Sequence[arb]) -> NDArray[np.float64]:
    rows = [i for i in range(layout.stages) if layout.lengths[i]]
    bushes = [((),) * nodes(word) for word in words]
    quantities = [Quantity(i, word) for i in rows for word in [*words, *bushes]]
    found = iter(Weights(layout, quantities).evaluate(y[: layout.size]))
    matrix = []
    for _ in rows:
        weights = [next(found) for _ in words]
        powers = [next(found) for _ in bushes]
        matrix.append(
            [
                float(w - p * _ratio(word, bush))
                for w, p, word, bush in zip(weights, powers, words, bushes, strict=True)
            ]
        )
    return np.array(matrix)


def _ratio(word: Word, bush: Word) -> Any:
    ratio = reciprocal_density(word) / reciprocal_density(bush)
    return fmpq(ratio.numerator, ratio.denominator)


def names_of_left_out(conditions: Sequence[Condition], structure: str = "") -> tuple[str, ...]:
    """Write which conditions follow from others by orthogonality, for `read_left_out`.

    And by a structure, one of `STRUCTURES`, whose equations are held as well.
    """
    trees = " ".join(f"{row * '*'}{text(word)}" for row, word in conditions)
    return (*filter(None, [structure]), f"{_ORTHOGONAL} {trees}")


def read_left_out(names: Sequence[str]) -> tuple[list[Condition], str]:
    """Return the conditions that follow by orthogonality, and the structure's name, if any.

    No conditions if the identities are others.

    Raises
    ------
    ValueError
        If a name has anything else.
    """
    structure = names[0] if names and names[0] in STRUCTURES else ""
    rest = list(names[bool(structure) :])
    if len(rest) != 1 or not rest[0].startswith(f"{_ORTHOGONAL} "):
        return [], ""
    trees = rest[0].removeprefix(_ORTHOGONAL).split()
    return [(int(one.startswith("*")), parse(one.removeprefix("*"))) for one in trees], structure


def names_of_small(conditions: Sequence[Condition], bound: str) -> tuple[str, ...]:
    """Write which conditions are only shown to be small at a zero of others, for `read_small`."""
    trees = " ".join(f"{row * '*'}{text(word)}" for row, word in conditions)
    return (f"{_SMALL_ONLY} {bound}: {trees}",)


def read_small(names: Sequence[str]) -> tuple[list[Condition], Fraction | None]:
    """Return the conditions that are only shown to be small, and the bound.

    No conditions, and None, if there aren't any.

    Raises
    ------
    ValueError
        If there is anything else besides.
    """
    heading, _, trees = names[0].partition(": ") if names else ("", "", "")
    if not heading.startswith(f"{_SMALL_ONLY} "):
        return [], None
    bound = read_fraction(heading.removeprefix(_SMALL_ONLY).strip())
    if len(names) > 1 or not 0 < bound <= MAX_SMALL:
        raise ValueError("conditions that are only small need a small bound, and nothing else")
    found = [(int(one.startswith("*")), parse(one.removeprefix("*"))) for one in trees.split()]
    return found, bound


def without(
    layout: Layout,
    orders: Sequence[int],
    left_out: Sequence[Condition],
    more: Sequence[Equation] = (),
) -> EquationSystem:
    """Return the order conditions but those that are left out, and more equations.

    Raises
    ------
    ValueError
        If something that is left out is no independent condition, or is there twice.
    """
    known = conditions_of(orders)
    gone = set(left_out)
    if len(gone) != len(left_out) or not gone.issubset(known):
        raise ValueError("conditions that are left out must be distinct independent ones")
    equations = []
    for row, word in known:
        if (row, word) not in gone:
            equation = condition(word, layout.stages + row)
            label = f"{text(word)} embedded" if row else equation.label
            equations.append(equation._replace(label=label))
    return EquationSystem(layout, (*equations, *more))


def augment(
    layout: Layout,
    orders: Sequence[int],
    identities: Sequence[Identity],
    zeros: Sequence[Collection[int]],
) -> EquationSystem:
    """Return a system of which all order conditions follow by identities.

    Parameters
    ----------
    layout : Layout
    orders : sequence of int
        Of b, and of the second weights of a pair.
    identities : sequence of Identity
    zeros : sequence of collections of int
        For the same rows of weights, the stages (from 0) where they are held at zero.

    Raises
    ------
    ArithmeticError
        If that the conditions follow couldn't be shown.
    ValueError
        If an identity doesn't fit the layout.
    """
    if identities and layout.rows is None:
        raise ValueError("identities are about tableaux")
    equations, count = [], 0
    for identity in identities:
        equations += identity.equations(layout, zeros, count)
        count += len(identity.parameters)
    for r, (order, held) in enumerate(zip(orders, zeros, strict=True)):
        known = [one for one in identities if not (r and isinstance(one, OfFirstWeights))]
        for grade in range(1, order + 1):
            for word in kept_words(grade, known, held):
                equation = condition(word, layout.stages + r)
                label = f"{text(word)} embedded" if r else equation.label
                equations.append(equation._replace(label=label))
    return EquationSystem(layout, tuple(equations), count)
