"""Tableaux of Crouch–Grossman methods."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.layouts import Layout, Rows, rows_of
from cg.construction.methods.coefficients import Coefficient, read_row, read_sequence, read_texts
from cg.construction.methods.method import ExactTableau, Method, frozen
from cg.construction.points import MethodError, PointTree, tree_of_rows

Entries = tuple[tuple[Coefficient, ...], ...]


class TableauError(MethodError):
    """Raised if coefficients don't make a tableau; the message names the wrong one.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> try:
    ...     cg.Tableau([[], ["1/2"]], ["1/2", "1/z"])
    ... except cg.TableauError as error:
    ...     print(error)
    b_2: expected a finite real number, got '1/z'
    """


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Tableau(Method):
    """A Runge–Kutta method of Crouch–Grossman type, (2.2) and (2.3) of the paper.

    Tableaux are equal if all their coefficients are equal.

    Parameters
    ----------
    a
        Sequence of s rows. All of length s, or the strictly lower part (lengths 0 to s - 1), or the
        lower part (1 to s). Nonzero entries on or above the diagonal make the method implicit.
        Entries are strings, Fractions, integers or floats; see `Coefficient.read`.
    b
        Sequence of s numbers.
    name, source
        Name and origin of the method.
    b_embedded
        Sequence of s numbers. Second weights of a pair, different from b.
    nominal_order
        The intended order of a method that satisfies its order conditions only approximately;
        given together with `nominal_residual`.
    nominal_residual
        Upper bound of the absolute residuals through `nominal_order`.

    Attributes
    ----------
    entries, weights, embedded_weights
        The coefficients with their text.

    Raises
    ------
    TableauError
        If a shape is wrong, a number isn't finite, both weights are the same, or residuals exceed
        `nominal_residual`.

    Examples
    --------
    >>> midpoint = Tableau([[], ["1/2"]], [0, 1], name="midpoint")
    >>> midpoint.order, midpoint.stages, midpoint.exponentials
    (2, 2, 2)
    """

    name: str
    source: str
    entries: Entries
    weights: tuple[Coefficient, ...]
    embedded_weights: tuple[Coefficient, ...] | None
    nominal_order: int | None
    nominal_residual: Coefficient | None

    def __init__(
        self, a: Iterable[Iterable[Any]], b: Iterable[Any], *, name: str = "", source: str = "",
        b_embedded: Iterable[Any] | None = None, nominal_order: int | None = None,
        nominal_residual: Any = None,
    ) -> None:  # fmt: skip
        try:
            values = read_texts(name, source, nominal_order, nominal_residual)
            weights = read_row(b, "b", None, "b_{}")
            stages = len(weights)
            embedded = None
            if b_embedded is not None:
                embedded = read_row(b_embedded, "b_embedded", stages, "b_embedded_{}")
                if _values(embedded) == _values(weights):
                    raise MethodError("b_embedded must differ from b, or it estimates no error")
            rows = {"weights": weights, "embedded_weights": embedded}
            vars(self).update(values | rows | {"entries": _read_matrix(a, stages)})
            self._check_nominal_order()
        except MethodError as problem:
            raise TableauError(str(problem)) from None

    @classmethod
    def from_layout(cls, layout: Layout, coefficients: Sequence[Any], **fields: Any) -> Tableau:
        """Return the tableau with a layout and packed entries, row by row.

        `fields` are further keyword arguments of the class, such as `name` and `source`.
        """
        rows = layout.full_rows(coefficients)
        a, (b, *second) = rows[: layout.stages], rows[layout.stages :]
        return cls(a, b, b_embedded=second[0] if second else None, **fields)

    def _with(self, coefficients: Sequence[Any], **fields: Any) -> Tableau:
        return Tableau.from_layout(self.layout, coefficients, **fields)

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.exact, self.exact_embedded

    @cached_property
    def exact(self) -> ExactTableau:
        return tuple(map(_values, self.entries)), _values(self.weights)

    @cached_property
    def a(self) -> NDArray[np.float64]:
        """The rows, rounded to double; shape (s, s), read-only."""
        return frozen(self.exact[0])

    @cached_property
    def exact_embedded(self) -> tuple[Fraction, ...] | None:
        return None if self.embedded_weights is None else _values(self.embedded_weights)

    @cached_property
    def rows(self) -> Rows:
        """The narrowest pattern that contains all nonzero entries of a."""
        return rows_of(self.exact[0])

    @property
    def explicit(self) -> bool:
        return self.rows is Rows.EXPLICIT

    @cached_property
    def tree(self) -> PointTree:
        """The points of a step: each row is a chain of flows of one frozen field each."""
        return tree_of_rows(*self.exact, self.exact_embedded)

    @cached_property
    def layout(self) -> Layout:
        return Layout.tableau(self.stages, self.rows, self.embedded_weights is not None)

    @cached_property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """All coefficients, row by row, second weights last."""
        second = () if self.embedded_weights is None else (self.embedded_weights,)
        return tuple(self.layout.packed([*self.entries, self.weights, *second]))

    @cached_property
    def exponentials(self) -> int:
        """Number of flows of a step.

        Initial flows that several rows share count once. Flows of the second weights of a pair
        don't count; see `pair_exponentials`. For an implicit method, whose stages are iterated,
        all nonzero entries of a and b count.
        """
        if self.explicit:
            return super().exponentials
        a, b = self.exact
        return sum(entry != 0 for row in (*a, b) for entry in row)

    @cached_property
    def embedded(self) -> Tableau | None:
        if self.embedded_weights is None:
            return None
        return Tableau(self.entries, self.embedded_weights, **self._embedded_names)


def _values(row: Iterable[Coefficient]) -> tuple[Fraction, ...]:
    return tuple(coefficient.value for coefficient in row)


def _read_matrix(a: Any, stages: int) -> Entries:
    rows = [read_sequence(row, f"row {i} of a") for i, row in enumerate(read_sequence(a, "a"), 1)]
    lengths = [len(row) for row in rows]
    allowed = ([stages] * stages, list(range(stages)), list(range(1, stages + 1)))
    if lengths not in allowed:
        raise MethodError(
            f"a must have {stages} rows to match b, all of length {stages} or of lengths "
            f"0 to {stages - 1} (strictly lower) or 1 to {stages} (lower), got lengths {lengths}"
        )
    separator = "," if stages > 9 else ""
    zero = Coefficient.read(0)
    return tuple(
        (*read_row(row, "row", len(row), f"a_{i}{separator}{{}}"), *[zero] * (stages - len(row)))
        for i, row in enumerate(rows, 1)
    )
