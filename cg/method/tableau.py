"""The tableau of a Crouch–Grossman method: frozen, checked, exact."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from ..structure.layout import Layout, Rows, check_length, rows_of, unknowns
from ..structure.points import MethodError, PointTree, tree_of_rows
from ..support.checks import check_integer
from ..support.quads import DECIMAL_DIGITS, to_decimal
from .coefficients import Coefficient
from .method import ExactTableau, Method, read_coefficient, read_texts

__all__ = ["Tableau", "TableauError"]

Entries = tuple[tuple[Coefficient, ...], ...]


class TableauError(MethodError):
    """The coefficients don't make a tableau; the message names the one at fault.

    Examples
    --------
    >>> import cg
    >>> try:
    ...     cg.Tableau([[0, 1], ["1/2", 0]], ["1/2", "1/2"], explicit=True)
    ... except cg.TableauError as error:
    ...     print(error)
    a must be strictly lower in an explicit tableau, but a_12 = 1
    """


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Tableau(Method):
    """A Runge–Kutta method of Crouch–Grossman type, (2.2) and (2.3) of the paper.

    All coefficients are kept as they were given; numbers derived from them are exact or
    correctly rounded. Tableaux are equal if all their coefficients are.

    Parameters
    ----------
    a : sequence of s rows
        All of length s, or the strictly lower part (lengths 0 to s - 1), or the lower part
        (1 to s). Entries as `Coefficient.read` takes them: strings, Fractions, integers,
        floats.
    b : sequence of s numbers
    name, source : str, optional
        What the method is called and where it is from.
    b_embedded : sequence of s numbers, optional
        Second weights, different from b, that make the method a pair.
    explicit : bool, optional
        Insist on a strictly lower a; otherwise entries on or above the diagonal make the
        method implicit.
    nominal_order : int, optional
        For a method that satisfies its order conditions only approximately: the order it
        is meant to have. It comes with `nominal_residual`.
    nominal_residual : number, optional
        The size that no residual through `nominal_order` exceeds.

    Attributes
    ----------
    entries, weights, embedded_weights : tuples of Coefficient
        The coefficients with their text.

    Raises
    ------
    TableauError
        If a shape is wrong, a number isn't finite, ``a`` isn't strictly lower although it
        should be, both weights are the same, or a nominal order isn't borne out.

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
        self,
        a: Iterable[Iterable[Any]],
        b: Iterable[Any],
        *,
        name: str = "",
        source: str = "",
        b_embedded: Iterable[Any] | None = None,
        explicit: bool = False,
        nominal_order: int | None = None,
        nominal_residual: Any = None,
    ) -> None:
        values = read_texts(name, source, (nominal_order, nominal_residual), TableauError)
        if not isinstance(explicit, bool | np.bool_):
            raise TableauError(f"explicit must be True or False, got {explicit!r}")
        weights = _read_row(b, "b", "b_{}", None)
        stages = len(weights)
        if stages == 0:
            raise TableauError("b must have at least one entry, got none")
        embedded = None
        if b_embedded is not None:
            embedded = _read_row(b_embedded, "b_embedded", "b_embedded_{}", stages)
            if _values(embedded) == _values(weights):
                raise TableauError("b_embedded must differ from b, or it estimates no error")
        values["entries"] = _read_matrix(a, stages, explicit)
        values["weights"] = weights
        values["embedded_weights"] = embedded
        for field, value in values.items():
            object.__setattr__(self, field, value)
        if self.nominal_order is not None:
            self._check_nominal_order(TableauError)

    @classmethod
    def from_packed(
        cls,
        x: Sequence[Any],
        stages: int,
        rows: Rows = Rows.EXPLICIT,
        *,
        digits: int | None = None,
        **names: Any,
    ) -> Tableau:
        """Make a tableau of packed entries, row by row with b last.

        Parameters
        ----------
        x : sequence of numbers, length ``conditions.unknowns(stages, rows)``
        stages : int
        rows : Rows, optional
        digits : int, optional
            Round to so many significant decimals, at most 36. A binary128 number is good
            for 34 of them; without rounding, Fractions count as exact.
        **names
            Further keyword arguments of `Tableau`.

        Raises
        ------
        TableauError
            If x has the wrong length, or as for `Tableau`.
        """
        if digits is not None:
            try:
                digits = check_integer("digits", digits, 1, DECIMAL_DIGITS)
            except ValueError as error:
                raise TableauError(str(error)) from None
            numbers = enumerate(_listed(x, "x"), 1)
            x = [to_decimal(_read(entry, f"x_{k}").value, digits) for k, entry in numbers]
        try:
            entries = _listed(x, "x")
            check_length(entries, unknowns(stages, rows))  # before there is a layout of so many
            *a, b = Layout.tableau(stages, rows).full_rows(entries)
        except ValueError as error:
            raise TableauError(str(error)) from None
        return cls(a, b, **names)

    @classmethod
    def from_layout(cls, layout: Layout, coefficients: Sequence[Any], **names: Any) -> Tableau:
        """Return the tableau with these entries, row by row, b and second weights last."""
        rows = layout.full_rows(coefficients)
        a, weights = rows[: layout.stages], rows[layout.stages :]
        return cls(a, weights[0], b_embedded=weights[1] if layout.pair else None, **names)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what was derived: arrays would come back writeable."""
        return {field.name: self.__dict__[field.name] for field in fields(self)}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Tableau):
            return NotImplemented
        return self.exact == other.exact and self.exact_embedded == other.exact_embedded

    def __hash__(self) -> int:
        return hash((self.exact, self.exact_embedded))

    @cached_property
    def exact(self) -> ExactTableau:
        """``(a, b)`` as tuples of Fractions, shapes (s, s) and (s,)."""
        return tuple(map(_values, self.entries)), _values(self.weights)

    @cached_property
    def exact_embedded(self) -> tuple[Fraction, ...] | None:
        """The second weights of a pair as Fractions, shape (s,); None without."""
        return None if self.embedded_weights is None else _values(self.embedded_weights)

    @cached_property
    def rows(self) -> Rows:
        """The narrowest pattern that holds all nonzero entries of a."""
        return rows_of(self.exact[0])

    @property
    def explicit(self) -> bool:
        """Whether a is strictly lower."""
        return self.rows is Rows.EXPLICIT

    @cached_property
    def tree(self) -> PointTree:
        """The points of a step: each row is a chain of flows along one frozen field each."""
        return tree_of_rows(*self.exact, self.exact_embedded)

    @cached_property
    def layout(self) -> Layout:
        """Where each coefficient stands in `coefficients`."""
        return Layout.tableau(self.stages, self.rows, self.embedded_weights is not None)

    @cached_property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """All coefficients with their text, row by row, second weights last."""
        second = () if self.embedded_weights is None else (self.embedded_weights,)
        return tuple(self.layout.packed([*self.entries, self.weights, *second]))

    @cached_property
    def exponentials(self) -> int:
        """Flows that a step takes, to the stages and the result.

        First flows that several rows share count once. The second weights of a pair aren't
        counted: see `pair_exponentials`. Of an implicit method, whose stages are iterated,
        all nonzero entries of a and b count.
        """
        if self.explicit:
            return super().exponentials
        a, b = self.exact
        return sum(entry != 0 for row in (*a, b) for entry in row)

    @cached_property
    def embedded(self) -> Tableau | None:
        """The method with the second weights in place of the first; None without them."""
        if self.embedded_weights is None:
            return None
        name = f"{self.name}, embedded" if self.name else ""
        return Tableau(self.entries, self.embedded_weights, name=name, source=self.source)


def _values(row: Iterable[Coefficient]) -> tuple[Fraction, ...]:
    return tuple(coefficient.value for coefficient in row)


def _read(number: Any, label: str) -> Coefficient:
    return read_coefficient(number, label, TableauError)


def _read_row(row: Any, label: str, entry: str, length: int | None) -> tuple[Coefficient, ...]:
    numbers = _listed(row, label)
    if length is not None and len(numbers) != length:
        raise TableauError(f"{label} must have {length} entries, got {len(numbers)}")
    return tuple(_read(number, entry.format(i)) for i, number in enumerate(numbers, 1))


def _read_matrix(a: Any, stages: int, explicit: bool) -> Entries:
    rows = [_listed(row, f"row {i} of a") for i, row in enumerate(_listed(a, "a"), 1)]
    lengths = [len(row) for row in rows]
    allowed = ([stages] * stages, list(range(stages)), list(range(1, stages + 1)))
    if lengths not in allowed:
        raise TableauError(
            f"a must have {stages} rows to match b, all of length {stages} or of lengths "
            f"0 to {stages - 1} (strictly lower) or 1 to {stages} (lower), got lengths {lengths}"
        )
    separator = "," if stages > 9 else ""
    entries = []
    for i, row in enumerate(rows, 1):
        padded = [*row, *[0] * (stages - len(row))]
        labels = [f"a_{i}{separator}{j}" for j in range(1, stages + 1)]
        entries.append(tuple(map(_read, padded, labels)))
        for j in range(i, stages + 1):
            if explicit and entries[-1][j - 1].value != 0:
                raise TableauError(
                    f"a must be strictly lower in an explicit tableau, "
                    f"but {labels[j - 1]} = {entries[-1][j - 1].text}"
                )
    return tuple(entries)


def _listed(value: Any, label: str) -> list[Any]:
    # the order of a set is no order, and a mapping gives its keys
    if isinstance(value, str | bytes | Set | Mapping):
        raise TableauError(f"{label} must be a sequence of numbers, got {value!r}")
    try:
        return list(value)
    except TypeError:
        raise TableauError(f"{label} must be a sequence of numbers, got {value!r}") from None
