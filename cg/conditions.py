"""Order conditions of Runge–Kutta methods of Crouch–Grossman type.

A tableau has order q if ``Φ(t) = 1/γ(t)`` for all ordered trees with 2 to q + 1 nodes,
(2.4) of Jackiewicz, Marthinsen and Owren. The weights are, with the leftmost child on
the smallest stage::

    Φ_r(τ) = 1
    Φ_r([t_1 … t_μ]) = Σ_{i_1 ≤ … ≤ i_μ} Π_j a_{r,i_j} Φ_{i_j}(t_j) / Π (runs of equal i)!

and ``Φ`` itself has ``b`` in place of ``a_r``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Sized
from enum import IntEnum
from fractions import Fraction
from functools import lru_cache
from math import factorial
from typing import Any

import numpy as np
from flint import fmpq
from numpy.typing import ArrayLike, NDArray

from . import _core_r64, _core_r128
from .checks import check_integer
from .quad import decode, encode
from .trees import MOST_NODES, forest

__all__ = [
    "HIGHEST_ORDER",
    "Rows",
    "check_rows",
    "condition_trees",
    "count",
    "count_classical",
    "jacobian",
    "pack",
    "residuals",
    "residuals_exact",
    "residuals_quad",
    "right_sides",
    "stage_weights",
    "table_rows",
    "unknowns",
    "unpack",
    "weights",
]

HIGHEST_ORDER: int = int(_core_r64.highest_order())
"""Highest order that the compiled tables of trees hold (a build option)."""

_MOST_TREES_ORDER = MOST_NODES - 1

ExactRows = Sequence[Sequence[Any]]


class Rows(IntEnum):
    """Which entries of ``a`` a tableau may have; the numbers are those of the compiled core."""

    EXPLICIT = 0
    DIAGONAL = 1
    FULL = 2


def check_rows(rows: Rows | str | int) -> Rows:
    """Return a pattern given by itself, its name or its number.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if isinstance(rows, Rows):
        return rows
    names = {pattern.name.lower(): pattern for pattern in Rows}
    if isinstance(rows, str) and rows in names:
        return names[rows]
    if isinstance(rows, int | np.integer) and not isinstance(rows, bool) and rows in tuple(Rows):
        return Rows(rows)
    raise ValueError(f"rows must be one of {', '.join(names)}, got {rows!r}")


def _check_order(order: int, highest: int | None = HIGHEST_ORDER) -> int:
    checked = check_integer("order", order, 1, None if highest else _MOST_TREES_ORDER)
    if highest is not None and checked > highest:
        raise ValueError(
            f"order must be at most {highest}, the highest that the tables were built for "
            f"(build option highest_order), got {order}"
        )
    return checked


@lru_cache(maxsize=None, typed=True)  # typed, or True would be found as 1
def condition_trees(order: int, independent: bool = False) -> tuple[int, ...]:
    """Return the indices of the trees whose conditions give this order.

    Parameters
    ----------
    order : int
        At least 1.
    independent : bool, optional
        Leave out the trees whose condition follows from those of lower order: keep
        the words of trees that are Lyndon words.
    """
    order = _check_order(order, None)
    trees = forest(order + 1)
    indices = range(2, len(trees) + 1)
    if not independent:
        return tuple(indices)
    return tuple(index for index in indices if trees.is_independent(index))


@lru_cache(maxsize=None, typed=True)
def table_rows(order: int) -> tuple[int, ...]:
    """Return the paper's integer table: tree indices, zero where a tree can be discarded."""
    independent = set(condition_trees(order, independent=True))
    return tuple(t if t in independent else 0 for t in condition_trees(order))


def count(order: int, independent: bool = False) -> int:
    """Return the number of order conditions through `order` (``N_CG`` if independent)."""
    return len(condition_trees(_check_order(order, None), independent))


def count_classical(order: int) -> int:
    """Return ``N_RK``: rooted trees, children unordered, with 1 to `order` nodes.

    A rooted tree is a multiset of rooted trees under a root; this counts such
    multisets by the usual recurrence over divisors.
    """
    order = check_integer("order", order, 1)
    trees = [0, 1]
    for n in range(1, order):
        total = 0
        for k in range(1, n + 1):
            of_size = sum(d * trees[d] for d in range(1, k + 1) if k % d == 0)
            total += of_size * trees[n - k + 1]
        trees.append(total // n)
    return sum(trees)


def right_sides(order: int, independent: bool = False) -> tuple[Fraction, ...]:
    """Return ``1/γ(t)`` for the trees of `condition_trees`."""
    trees = forest(_check_order(order, None) + 1)
    return tuple(Fraction(1, trees.density[t - 1]) for t in condition_trees(order, independent))


def unknowns(stages: int, rows: Rows = Rows.EXPLICIT) -> int:
    """Return the number of entries of a tableau: s(s + 1)/2 for explicit ones."""
    s = check_integer("stages", stages, 1)
    above = {Rows.EXPLICIT: s * (s - 1) // 2, Rows.DIAGONAL: s * (s + 1) // 2, Rows.FULL: s * s}
    return above[check_rows(rows)] + s


def row_lengths(stages: int, rows: Rows) -> tuple[int, ...]:
    """Return how many entries each row of ``a`` has, and ``b`` last."""
    stages = check_integer("stages", stages, 1)
    lengths = {
        Rows.EXPLICIT: range(stages),
        Rows.DIAGONAL: range(1, stages + 1),
        Rows.FULL: (stages,) * stages,
    }[check_rows(rows)]
    return (*lengths, stages)


def rows_of(a: Sequence[Sequence[Any]] | NDArray[Any]) -> Rows:
    """Return the narrowest pattern that holds all nonzero entries of ``a``."""
    reach = max(
        (j - i for i, row in enumerate(a) for j, entry in enumerate(row) if entry != 0), default=-1
    )
    return Rows.EXPLICIT if reach < 0 else Rows.DIAGONAL if reach == 0 else Rows.FULL


def _check_tableau(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    checked = []
    for name, value in (("a", a), ("b", b)):
        try:
            if np.ma.is_masked(value):
                raise TypeError("masked")
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{name} must be an array of real numbers, got {value!r}") from None
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite, got {array}")
        checked.append(array)
    weights_, stages = checked[1], checked[1].size
    if weights_.ndim != 1 or stages == 0:
        raise ValueError(f"b must have shape (s,) with s at least 1, got {weights_.shape}")
    if checked[0].shape != (stages, stages):
        raise ValueError(
            f"a must have shape ({stages}, {stages}) to match b, got {checked[0].shape}"
        )
    return checked[0], weights_


def pack(a: ArrayLike, b: ArrayLike, rows: Rows | None = None) -> NDArray[np.float64]:
    """Pack a tableau's entries row by row, ``b`` last.

    Parameters
    ----------
    a : array_like, shape (s, s)
    b : array_like, shape (s,)
    rows : Rows, optional
        Which entries to take; by default the narrowest pattern that loses none.

    Returns
    -------
    ndarray, shape (unknowns(s, rows),)

    Raises
    ------
    ValueError
        If shapes don't match, an entry isn't finite, or `rows` would lose a nonzero entry.
    """
    a_array, b_array = _check_tableau(a, b)
    narrowest = rows_of(a_array)
    rows = narrowest if rows is None else check_rows(rows)
    if rows < narrowest:
        raise ValueError(f"a has nonzero entries outside the pattern {rows.name.lower()}")
    lengths = row_lengths(b_array.size, rows)
    return np.concatenate([*(a_array[r, : lengths[r]] for r in range(b_array.size)), b_array])


def unpack(
    x: Sequence[Any] | NDArray[Any], stages: int, rows: Rows = Rows.EXPLICIT
) -> tuple[list[list[Any]], list[Any]]:
    """Unpack what `pack` packed, into full rows of ``a`` and ``b``; zeros are ints."""
    lengths = row_lengths(stages, rows)
    if isinstance(x, str | bytes) or not isinstance(x, Sized):
        raise ValueError(f"x must be a sequence of numbers, got {x!r}")
    if len(x) != sum(lengths):
        raise ValueError(f"x must have {sum(lengths)} entries, got {len(x)}")
    cut, begin = [], 0
    for length in lengths:
        cut.append([*x[begin : begin + length], *[0] * (stages - length)])
        begin += length
    return cut[:-1], cut[-1]


def stage_weights(a: ArrayLike, order: int) -> NDArray[np.float64]:
    """Return ``Φ_r(t)`` for all trees with at most `order` nodes.

    Parameters
    ----------
    a : array_like, shape (s, s)
    order : int

    Returns
    -------
    ndarray, shape (s, trees)
        Column k belongs to the tree with index k + 1.
    """
    order = _check_order(order)
    size = len(a) if isinstance(a, Sized) else 0
    a_array, b_array = _check_tableau(a, np.zeros(max(size, 1)))
    x = pack(a_array, b_array)
    trees = len(forest(order))
    rows = rows_of(a_array)
    found: NDArray[np.float64] = _core_r64.stage_weights(order, b_array.size, rows, x, trees)
    return np.ascontiguousarray(found)


def weights(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t)`` for the trees of `condition_trees`; arguments as for `residuals`."""
    return _call(_core_r64.weights, a, b, order, independent)


def residuals(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False
) -> NDArray[np.float64]:
    """Return ``Φ(t) - 1/γ(t)`` for all conditions through an order, in double precision.

    Parameters
    ----------
    a : array_like, shape (s, s)
        Any real matrix; implicit tableaux are those with entries on or above the diagonal.
    b : array_like, shape (s,)
    order : int
        Between 1 and `HIGHEST_ORDER`.
    independent : bool, optional
        Only the conditions that don't follow from others of lower order.

    Returns
    -------
    ndarray, shape (count(order, independent),)

    Raises
    ------
    ValueError
        If a shape doesn't match, an entry isn't finite, or the order is out of range.
    """
    return _call(_core_r64.residuals, a, b, order, independent)


def jacobian(
    a: ArrayLike, b: ArrayLike, order: int, independent: bool = False, rows: Rows | None = None
) -> NDArray[np.float64]:
    """Return the derivatives of `residuals` by the packed entries of the tableau.

    Parameters
    ----------
    a, b, order, independent
        As for `residuals`.
    rows : Rows, optional
        The entries to derive by; by default the narrowest pattern that holds ``a``.

    Returns
    -------
    ndarray, shape (count(order, independent), unknowns(s, rows))
    """
    return _call(_core_r64.jacobian, a, b, order, independent, rows)


def _call(
    routine: Any,
    a: ArrayLike,
    b: ArrayLike,
    order: int,
    independent: bool,
    rows: Rows | None = None,
) -> NDArray[np.float64]:
    order = _check_order(order)
    a_array, b_array = _check_tableau(a, b)
    rows = rows_of(a_array) if rows is None else check_rows(rows)
    x = pack(a_array, b_array, rows)
    trees = condition_trees(order, independent)
    result: NDArray[np.float64] = routine(
        order, b_array.size, rows, x, np.array(trees, dtype=np.intc)
    )
    return np.ascontiguousarray(result)


def residuals_quad(
    x: Sequence[Fraction],
    stages: int,
    order: int,
    independent: bool = False,
    rows: Rows = Rows.EXPLICIT,
) -> list[Fraction]:
    """Return the residuals as ``real(16)`` arithmetic gives them, for packed entries.

    The entries are rounded to binary128 first; the result is exactly what was computed.
    """
    order = _check_order(order)
    trees = condition_trees(order, independent)
    if len(x) != unknowns(stages, rows):
        raise ValueError(f"x must have {unknowns(stages, rows)} entries, got {len(x)}")
    bits = _core_r128.residuals(order, stages, rows, encode(x).T, np.array(trees, dtype=np.intc))
    return decode(bits.T)


def residuals_exact(
    a: ExactRows, b: Sequence[Any], order: int, independent: bool = False
) -> tuple[Fraction, ...]:
    """Return ``Φ(t) - 1/γ(t)`` in exact rational arithmetic.

    This follows the definition word by word and shares no code with the compiled
    core, whose oracle it is.

    Parameters
    ----------
    a : sequence of s sequences of s numbers
        Anything that `fractions.Fraction` takes: integers, floats, ``"119/216"``, ``"0.25"``.
    b : sequence of s numbers
    order : int
        Between 1 and 13; not limited by the compiled tables.
    independent : bool, optional
        As for `residuals`.

    Returns
    -------
    tuple of Fraction

    Raises
    ------
    ValueError
        If a shape doesn't match, an entry isn't a finite real number, or the order is out of
        range.
    """
    order = _check_order(order, None)
    weights_row = _rationals(b, "b")
    if not isinstance(a, Iterable) or isinstance(a, str | bytes):
        raise ValueError(f"a must be a sequence of rows, got {a!r}")
    rows = [_rationals(row, f"row {i} of a") for i, row in enumerate(a, 1)]
    stages = len(weights_row)
    if stages == 0 or len(rows) != stages or any(len(row) != stages for row in rows):
        shape = (len(rows), sorted({len(row) for row in rows}))
        raise ValueError(f"a must have shape ({stages}, {stages}) to match b, got {shape}")
    trees = forest(order + 1)
    phi: list[list[fmpq]] = [[fmpq(1)] * stages]
    for word in trees.children[1 : trees.with_nodes(order).stop - 1]:
        phi.append([_word_weight(row, word, phi) for row in rows])
    return tuple(
        _fraction(_word_weight(weights_row, trees.children[t - 1], phi))
        - Fraction(1, trees.density[t - 1])
        for t in condition_trees(order, independent)
    )


def _rationals(entries: Any, name: str) -> list[fmpq]:
    if not isinstance(entries, Iterable) or isinstance(entries, str | bytes):
        raise ValueError(f"{name} must be a sequence of numbers, got {entries!r}")
    return [_rational(entry, name) for entry in entries]


def _rational(entry: Any, name: str) -> fmpq:
    try:
        value = Fraction(entry.item() if isinstance(entry, np.generic) else entry)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise ValueError(f"{name} must hold finite real numbers, got {entry!r}") from None
    # flint's rationals are many times faster where digits are many
    return fmpq(value.numerator, value.denominator)


def _fraction(value: fmpq) -> Fraction:
    return Fraction(int(value.p), int(value.q))


def _word_weight(row: Sequence[fmpq], word: Sequence[int], phi: Sequence[Sequence[fmpq]]) -> fmpq:
    """Sum over all ways to give the letters of a word to stages that don't decrease."""
    one = phi[0][0]  # of whatever field the entries are in
    taken = [one] + [one * 0] * len(word)  # taken[k]: first k letters have a stage
    for stage, entry in enumerate(row):
        if entry == 0:
            continue
        for end in range(len(word), 0, -1):
            product = one
            for begin in range(end - 1, -1, -1):
                product *= entry * phi[word[begin] - 1][stage]
                if product == 0:
                    break
                taken[end] += taken[begin] * product / factorial(end - begin)
    return taken[-1]
