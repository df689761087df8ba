"""The tableau of a Crouch–Grossman method: frozen, checked, exact."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import conditions
from .checks import check_flag, check_integer
from .coefficients import Coefficient
from .conditions import Rows
from .points import Point, PointTree, tree_of_rows
from .quad import DECIMAL_DIGITS, to_decimal

if TYPE_CHECKING:
    from .certification import Certificate

__all__ = ["Tableau", "TableauError"]

Entries = tuple[tuple[Coefficient, ...], ...]
ExactTableau = tuple[tuple[tuple[Fraction, ...], ...], tuple[Fraction, ...]]

TOLERANCE_FACTOR = 2
"""What a residual may exceed the first-order effect of the coefficients' last places by."""

_DOUBLE_ROUNDING = 2.0**-40  # far above what rounding in double can do to a weight, relatively


class TableauError(ValueError):
    """The coefficients don't make a tableau; the message names the one at fault."""


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Tableau:
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
        for label, text in (("name", name), ("source", source)):
            if not isinstance(text, str):
                raise TableauError(f"{label} must be a str, got {text!r}")
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
        values: dict[str, Any] = {
            "name": name,
            "source": source,
            "entries": _read_matrix(a, stages, explicit),
            "weights": weights,
            "embedded_weights": embedded,
            "nominal_order": nominal_order,
            "nominal_residual": None,
        }
        if (nominal_order is None) != (nominal_residual is None):
            raise TableauError("nominal_order and nominal_residual must be given together")
        if nominal_residual is not None:
            values["nominal_residual"] = _read(nominal_residual, "nominal_residual")
        for field, value in values.items():
            object.__setattr__(self, field, value)
        if self.nominal_order is not None:
            self._check_nominal_order()

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
                check_integer("digits", digits, 1, DECIMAL_DIGITS)
            except ValueError as error:
                raise TableauError(str(error)) from None
            entries = enumerate(_listed(x, "x"), 1)
            x = [to_decimal(_read(entry, f"x_{k}").value, digits) for k, entry in entries]
        try:
            a, b = conditions.unpack(_listed(x, "x"), stages, rows)
        except ValueError as error:
            raise TableauError(str(error)) from None
        return cls(a, b, **names)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what was derived: arrays would come back writeable."""
        return {field.name: self.__dict__[field.name] for field in fields(self)}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Tableau):
            return NotImplemented
        return self.exact == other.exact and self.exact_embedded == other.exact_embedded

    def __hash__(self) -> int:
        return hash((self.exact, self.exact_embedded))

    def __repr__(self) -> str:
        kind = "explicit" if self.explicit else "implicit"
        pair = ", a pair" if self.embedded_weights else ""
        return f"<Tableau {self.name or 'without name'}: {self.stages} stages, {kind}{pair}>"

    @cached_property
    def exact(self) -> ExactTableau:
        """``(a, b)`` as tuples of Fractions, shapes (s, s) and (s,)."""
        return tuple(map(_values, self.entries)), _values(self.weights)

    @cached_property
    def exact_embedded(self) -> tuple[Fraction, ...] | None:
        """The second weights of a pair as Fractions, shape (s,); None without."""
        return None if self.embedded_weights is None else _values(self.embedded_weights)

    @cached_property
    def a(self) -> NDArray[np.float64]:
        """Stage coefficients, rounded to double; shape (s, s), read-only."""
        return _frozen(self.exact[0])

    @cached_property
    def b(self) -> NDArray[np.float64]:
        """Weights, rounded to double; shape (s,), read-only."""
        return _frozen(self.exact[1])

    @cached_property
    def b_embedded(self) -> NDArray[np.float64] | None:
        """Second weights of a pair, rounded to double; shape (s,), read-only; None without."""
        return None if self.exact_embedded is None else _frozen(self.exact_embedded)

    @cached_property
    def c(self) -> NDArray[np.float64]:
        """Abscissae, the exact row sums of a rounded to double; shape (s,), read-only."""
        return _frozen(tuple(sum(row, Fraction(0)) for row in self.exact[0]))

    @property
    def stages(self) -> int:
        """Number of stages s."""
        return len(self.weights)

    @cached_property
    def rows(self) -> Rows:
        """The narrowest pattern that holds all nonzero entries of a."""
        return conditions.rows_of(self.exact[0])

    @property
    def explicit(self) -> bool:
        """Whether a is strictly lower."""
        return self.rows is Rows.EXPLICIT

    @cached_property
    def _tree(self) -> PointTree:
        if not self.explicit:
            raise AttributeError(f"{self!r} is implicit, so that its stages are not points in turn")
        return tree_of_rows(*self.exact, self.exact_embedded)

    @property
    def points(self) -> tuple[Point, ...]:
        """The points of a step of an explicit method, parents first; see `cg.points.Point`."""
        return self._tree.points

    @property
    def stage_points(self) -> tuple[int, ...]:
        """The point that each stage is at, -1 for the initial point."""
        return self._tree.stage_points

    @property
    def result(self) -> int:
        """The point that a step leads to."""
        return self._tree.result

    @property
    def embedded_result(self) -> int | None:
        """The point that the second weights of a pair lead to; None without them."""
        return self._tree.embedded_result

    @property
    def exponentials(self) -> int:
        """Flows that a step takes: the nonzero entries of a and b."""
        a, b = self.exact
        return sum(entry != 0 for row in (*a, b) for entry in row)

    @property
    def order(self) -> int:
        """The order: `nominal_order` if the method is `approximate`, else `exact_order`."""
        return self.exact_order if self.nominal_order is None else self.nominal_order

    @property
    def approximate(self) -> bool:
        """Whether `order` is only nominal: the order conditions hold approximately."""
        return self.nominal_order is not None

    @cached_property
    def exact_order(self) -> int:
        """The order that the coefficients have, as far as their stored places can tell.

        The largest q (0 to ``conditions.HIGHEST_ORDER``) such that every condition through
        order q has an exact residual no larger than `TOLERANCE_FACTOR` times
        ``Σ_k |∂Φ/∂x_k| u_k``, where u_k is how far coefficient k may be off
        (`Coefficient.unit`). Nothing is allowed for rational coefficients.
        """
        orders = range(1, conditions.HIGHEST_ORDER + 1)
        return next((q - 1 for q in orders if not self._satisfies(q)), orders[-1])

    @cached_property
    def embedded(self) -> Tableau | None:
        """The method with the second weights in place of the first; None without them."""
        if self.embedded_weights is None:
            return None
        name = f"{self.name}, embedded" if self.name else ""
        return Tableau(self.entries, self.embedded_weights, name=name, source=self.source)

    @property
    def embedded_order(self) -> int | None:
        """Order of the embedded method, found like `exact_order`; None without."""
        return None if self.embedded is None else self.embedded.exact_order

    def largest_residual(self, order: int | None = None) -> float:
        """Return the largest ``|Φ(t) - 1/γ(t)|`` through an order, from exact arithmetic.

        Parameters
        ----------
        order : int, optional
            By default the method's own order.
        """
        residuals = conditions.residuals_exact(*self.exact, self.order if order is None else order)
        return float(max(map(abs, residuals)))

    def principal_error(self, order: int | None = None) -> float:
        """Return the Euclidean norm of the residuals of order q + 1 (all trees, q + 2 nodes).

        Parameters
        ----------
        order : int, optional
            q, by default the method's own order.

        Raises
        ------
        ValueError
            If q + 1 is above ``conditions.HIGHEST_ORDER``.
        """
        order = self.order if order is None else check_integer("order", order, 0)
        residuals = conditions.residuals(self.a, self.b, order + 1)
        lower = conditions.count(order) if order else 0
        return float(np.linalg.norm(residuals[lower:]))

    def digits(
        self, digits: int, *, certificate: Certificate | None = None, embedded: bool = False
    ) -> tuple[list[list[str]], list[str]]:
        """Return the coefficients of the exact method, to any number of digits.

        Parameters
        ----------
        digits : int
            Significant digits of the coefficients that the certificate doesn't hold fixed.
        certificate : cg.Certificate, optional
            By default the one of the catalogue; see `cg.certify`.
        embedded : bool, optional
            Return the second weights in place of b.

        Returns
        -------
        a : list of s lists of s str
        b : list of s str
            All digits are right. Fixed coefficients are as they are stored.

        Raises
        ------
        CertificationError
            If there is no certificate, or it can't be proved.
        TypeError
            If an argument isn't of the type listed.
        ValueError
            If `digits` is out of range, or there are no second weights.
        """
        from .certification import certificate_of, refined_digits

        if check_flag("embedded", embedded) and self.embedded_weights is None:
            raise ValueError(f"embedded: {self.name or 'the method'} has no second weights")
        if certificate is None:
            certificate = certificate_of(self)
        found = refined_digits(self, certificate, digits)
        split = conditions.unknowns(self.stages, self.rows)
        a, b = conditions.unpack(found[:split], self.stages, self.rows)
        return [[str(entry) for entry in row] for row in a], found[split:] if embedded else b

    def _satisfies(self, order: int) -> bool:
        tolerance = self._tolerance(order)
        if not np.isfinite(tolerance).all():
            return False
        rough = np.abs(conditions.residuals(self.a, self.b, order, independent=True))
        sizes = conditions.weights(np.abs(self.a), np.abs(self.b), order, independent=True)
        if (rough > tolerance + _DOUBLE_ROUNDING * (1 + sizes)).any():
            return False  # spares exact arithmetic where it would be slowest
        residuals = conditions.residuals_exact(*self.exact, order, independent=True)
        return all(abs(r) <= Fraction(t) for r, t in zip(residuals, tolerance, strict=True))

    def _tolerance(self, order: int) -> NDArray[np.float64]:
        units_a = np.array([[float(entry.unit) for entry in row] for row in self.entries])
        units_b = np.array([float(weight.unit) for weight in self.weights])
        units = conditions.pack(units_a, units_b, self.rows)
        if not units.any():
            return np.zeros(conditions.count(order, independent=True))
        sensitivity = np.abs(
            conditions.jacobian(self.a, self.b, order, independent=True, rows=self.rows)
        )
        tolerance: NDArray[np.float64] = TOLERANCE_FACTOR * (sensitivity @ units)
        return tolerance

    def _check_nominal_order(self) -> None:
        assert self.nominal_residual is not None
        try:
            residuals = conditions.residuals(self.a, self.b, self.order)
        except (TypeError, ValueError) as error:
            raise TableauError(f"nominal_order: {error}") from None
        largest = float(np.abs(residuals).max())
        if not largest <= float(self.nominal_residual.value):
            raise TableauError(
                f"nominal_order {self.order} is not borne out: its residuals reach {largest:.3g}, "
                f"more than nominal_residual = {self.nominal_residual.text}"
            )


def _values(row: Iterable[Coefficient]) -> tuple[Fraction, ...]:
    return tuple(coefficient.value for coefficient in row)


def _frozen(numbers: Any) -> NDArray[np.float64]:
    array = np.array(numbers, dtype=np.float64)
    array.flags.writeable = False
    return array


def _read(number: Any, label: str) -> Coefficient:
    try:
        coefficient = Coefficient.read(number)
        float(coefficient.value)
    except ValueError as error:
        raise TableauError(f"{label}: {error}") from None
    except OverflowError:
        raise TableauError(f"{label}: {number} is beyond the range of doubles") from None
    return coefficient


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
