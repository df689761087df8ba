"""What all methods have in common: points, order, principal error."""

from __future__ import annotations

import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import conditions
from ..structure.layout import Layout
from ..structure.points import MethodError, Point, PointTree
from ..support.checks import check_flag, check_integer
from ..support.later import Later
from ..support.parsing import visible
from .coefficients import Coefficient

__all__ = ["TOLERANCE_FACTOR", "Method", "read_coefficient", "read_texts", "remembered"]

Result = TypeVar("Result")

ExactTableau = tuple[tuple[tuple[Fraction, ...], ...], tuple[Fraction, ...]]

TOLERANCE_FACTOR = 2
"""What a residual may exceed the first-order effect of the coefficients' last places by."""

_DOUBLE_ROUNDING = 2.0**-40  # far above what rounding in double can do to a weight, relatively
_MAX_IN_PASSING = 200  # coefficients of a method whose order is computed to show it: half a second
_MIN_UNIT = float(np.finfo(np.float64).tiny)
_PROBE = 2.0**-20  # of the largest unit, for a difference quotient


class Method(ABC):
    """A Runge–Kutta method on manifolds: a tree of points, exact, frozen and checked.

    All coefficients are kept as they were given; numbers derived from them are exact or
    correctly rounded. There are two kinds: `cg.Tableau` and `cg.CommutatorFree`.

    Attributes
    ----------
    name, source : str
        What the method is called and where it is from.
    nominal_order : int or None
        For a method that satisfies its order conditions only approximately: the order it is
        meant to have.
    nominal_residual : Coefficient or None
        The size that no residual through `nominal_order` exceeds.
    tree : PointTree
        The points of a step. Those of an implicit method depend on stages yet to be found.
    coefficients : tuple of Coefficient
        All coefficients with their text, packed as `layout` says.

    Examples
    --------
    >>> import cg
    >>> method = cg.methods["CF4"]
    >>> isinstance(method, cg.Method), method.order, method.stages, method.exponentials
    (True, 4, 4, 5)
    """

    name: str
    source: str
    nominal_order: int | None
    nominal_residual: Coefficient | None
    digits = Later("cg.proofs.digits", "digits")
    diagnose = Later("cg.analysis.diagnosis", "diagnose")
    export = Later("cg.formats.exporting", "export")
    load = Later("cg.catalogue.entries", "load_kind", of_class=True)
    save = Later("cg.catalogue.entries", "save")
    _repr_html_ = Later("cg.formats.notebooks", "to_html")
    _repr_latex_ = Later("cg.formats.notebooks", "to_formula")

    if TYPE_CHECKING:  # fields of one subclass, derived in the other

        @property
        def tree(self) -> PointTree:
            """The points of a step."""

        @property
        def coefficients(self) -> tuple[Coefficient, ...]:
            """All coefficients with their text."""

    @property
    @abstractmethod
    def layout(self) -> Layout:
        """Where each coefficient stands in `coefficients`."""

    @property
    @abstractmethod
    def embedded(self) -> Self | None:
        """The method that leads to the second result of a pair; None without it."""

    def __repr__(self) -> str:
        name = visible(self.name) or "without name"
        return f"<{type(self).__name__} {name}: {self.description()}>"

    def description(self, *, complete: bool = False) -> str:
        """Return order, evaluations and flows in words.

        Parameters
        ----------
        complete : bool, optional
            Name the order even where it takes seconds to compute: that of a method with more than
            200 coefficients is left out otherwise, unless it has been asked for before.

        Examples
        --------
        >>> import cg
        >>> cg.methods["CF5(4)"].description()
        'order 5(4), 7 evaluations, 9 flows'
        """
        complete = check_flag("complete", complete)
        parts = [f"{self.stages} evaluation{'s' * (self.stages != 1)}"]
        parts.append(f"{self.exponentials} flow{'s' * (self.exponentials != 1)}")
        if complete or self._order_is_cheap:
            pair = "" if self.embedded_order is None else f"({self.embedded_order})"
            parts.insert(0, f"order {self.order}{pair}{' (nominal)' * self.approximate}")
        elif self.layout.pair:
            parts.append("a pair")
        if not self.explicit:
            parts.append("implicit")
        return ", ".join(parts)

    @property
    def _order_is_cheap(self) -> bool:
        return len(self.coefficients) <= _MAX_IN_PASSING or "exact_order" in self.__dict__

    @property
    def explicit(self) -> bool:
        """Whether each stage follows from those before it."""
        return True

    @property
    def _explicit_tree(self) -> PointTree:
        if not self.explicit:
            raise AttributeError(f"{self!r} is implicit, so that its stages are not points in turn")
        return self.tree

    @property
    def points(self) -> tuple[Point, ...]:
        """The points of a step of an explicit method, parents first; see `Point`."""
        return self._explicit_tree.points

    @property
    def stage_points(self) -> tuple[int, ...]:
        """The point that each stage is at, -1 for the initial point."""
        return self._explicit_tree.stage_points

    @property
    def result(self) -> int:
        """The point that a step leads to."""
        return self._explicit_tree.result

    @property
    def embedded_result(self) -> int | None:
        """The point that the second weights of a pair lead to; None without them."""
        return self._explicit_tree.embedded_result

    @property
    def stages(self) -> int:
        """Number of stages s: evaluations of the right-hand side in a step."""
        return len(self.tree.stage_points)

    @cached_property
    def exponentials(self) -> int:
        """Flows that a step takes, to the stages and the result.

        First flows that several rows share count once, and so do points that only repeat
        another. The second result of a pair isn't counted: see `pair_exponentials`.
        """
        return self.tree.flows([*self.tree.stage_points, self.tree.result])

    @property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Weights on frozen fields of the error estimates, if these take no flow; else empty."""
        return ()

    @property
    def third_order(self) -> int | None:
        """Order of third weights, which refine the estimate of a pair; None without."""
        return None

    @cached_property
    def pair_exponentials(self) -> int:
        """Flows that a trial step takes: `exponentials`, and those to the second result.

        A second result that is one flow from the first isn't gone to, since the error is what this
        flow is along.
        """
        tree = self.tree
        if self.error_weights and not (self.embedded_order or 0) > self.order:
            return self.exponentials
        if not self.explicit:
            return self.exponentials + sum(entry != 0 for entry in self.exact_embedded or ())
        second = [] if tree.embedded_result is None else [tree.embedded_result]
        return tree.flows([*tree.stage_points, tree.result, *second])

    @cached_property
    def exact(self) -> ExactTableau:
        """``(a, b)`` as tuples of Fractions, shapes (s, s) and (s,): the flat tableau.

        Where flows commute, the method is the classical one with this tableau. Only of a
        `cg.Tableau` does it say all.
        """
        tree = self.tree
        return tuple(map(tree.flat_row, tree.stage_points)), tree.flat_row(tree.result)

    @cached_property
    def exact_embedded(self) -> tuple[Fraction, ...] | None:
        """The second weights of a pair as Fractions, shape (s,); None without."""
        second = self.tree.embedded_result
        return None if second is None else self.tree.flat_row(second)

    @cached_property
    def a(self) -> NDArray[np.float64]:
        """Stage coefficients of `exact`, rounded to double; shape (s, s), read-only."""
        return _frozen(self.exact[0])

    @cached_property
    def b(self) -> NDArray[np.float64]:
        """Weights of `exact`, rounded to double; shape (s,), read-only."""
        return _frozen(self.exact[1])

    @cached_property
    def b_embedded(self) -> NDArray[np.float64] | None:
        """Second weights of a pair, rounded to double; shape (s,), read-only; None without."""
        return None if self.exact_embedded is None else _frozen(self.exact_embedded)

    @cached_property
    def c(self) -> NDArray[np.float64]:
        """Abscissae, the exact row sums of a rounded to double; shape (s,), read-only."""
        return _frozen(tuple(sum(row, Fraction(0)) for row in self.exact[0]))

    @classmethod
    @abstractmethod
    def from_layout(cls, layout: Layout, coefficients: Sequence[Any], **names: Any) -> Self:
        """Return the method with these packed coefficients.

        Parameters
        ----------
        layout : Layout
            The shape of the method: where each coefficient stands.
        coefficients : sequence of numbers, length ``layout.size``
            What `cg.method.coefficients.Coefficient.read` takes; kept as given.
        **names
            Further keyword arguments of the class, such as `name` and `source`.

        Raises
        ------
        MethodError
            If they don't make a method.
        """

    def with_coefficients(self, coefficients: Sequence[Any], **names: Any) -> Self:
        """Return a method of the same shape with other coefficients, third weights left out.

        Parameters
        ----------
        coefficients : sequence of numbers
            In the order of `coefficients`.
        **names
            Further keyword arguments of the class, such as `name` and `source`.

        Examples
        --------
        >>> import cg
        >>> midpoint = cg.Tableau([[], ["1/2"]], [0, 1])
        >>> midpoint.with_coefficients(["2/3", "1/4", "3/4"]).order
        2
        """
        return self.from_layout(self.layout, coefficients, **names)

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

        The largest q (0 to ``conditions.MAX_ORDER``) such that every condition through
        order q has an exact residual no larger than `TOLERANCE_FACTOR` times
        ``Σ_k |∂Φ/∂x_k| u_k``, where u_k is how far coefficient k may be off
        (`Coefficient.unit`). Nothing is allowed for rational coefficients.
        """
        orders = range(1, conditions.MAX_ORDER + 1)
        return next((q - 1 for q in orders if not self.satisfies(q)), orders[-1])

    @property
    def embedded_order(self) -> int | None:
        """Order of the embedded method, found like `exact_order`; None without."""
        return None if self.embedded is None else self.embedded.exact_order

    def largest_residual(self, order: int | None = None) -> float:
        """Return the largest ``|Φ(t) - 1/γ(t)|`` through an order, from exact arithmetic.

        Parameters
        ----------
        order : int, optional
            By default the method's own order, or 1 if it has none.
        """
        order = max(self.order, 1) if order is None else order
        return float(max(map(abs, conditions.exact_residuals_of(self.tree, order))))

    def principal_error(self, order: int | None = None) -> float:
        """Return the Euclidean norm of the residuals of order q + 1 (all trees, q + 2 nodes).

        Parameters
        ----------
        order : int, optional
            q, by default the method's own order.

        Raises
        ------
        ValueError
            If q + 1 is above ``conditions.MAX_ORDER``.
        """
        if order is None:
            order = self.order
        else:
            order = check_integer("order", order, 0, conditions.MAX_ORDER - 1)
        residuals = conditions.residuals_of(self.tree, order + 1)
        lower = conditions.count(order) if order else 0
        return float(np.linalg.norm(residuals[lower:]))

    def satisfies(self, order: int) -> bool:
        """Tell whether the conditions through an order hold, as far as the stored places can tell.

        The tolerance is that of `exact_order`.
        """
        order = check_integer("order", order, 1)
        layout, x = self.layout, self._floats
        rough = np.abs(conditions.residuals_at(layout, x, order, independent=True))
        sizes = conditions.weights_at(layout, np.abs(x), order, independent=True)
        rounding = _DOUBLE_ROUNDING * (1 + sizes)
        if (rough > self._most_tolerance(order, sizes) + rounding).any():
            return False  # spares derivatives where there are most of them
        tolerance = self.tolerance(order)
        if not np.isfinite(tolerance).all():
            return False
        if (rough > tolerance + rounding).any():
            return False  # spares exact arithmetic where it would be slowest
        if (tolerance > 0).all():
            balls = conditions.ball_residuals_of(self.tree, order, independent=True)
            pairs = [(abs(r), float(t)) for r, t in zip(balls, tolerance, strict=True)]
            if all(r <= t for r, t in pairs) or any(r > t for r, t in pairs):
                return all(r <= t for r, t in pairs)
        residuals = conditions.exact_residuals_of(self.tree, order, independent=True)
        return all(abs(r) <= Fraction(t) for r, t in zip(residuals, tolerance, strict=True))

    @property
    def _floats(self) -> NDArray[np.float64]:
        return np.array([float(coefficient.value) for coefficient in self.coefficients])

    def _most_tolerance(self, order: int, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what `tolerance` can't exceed.

        With magnitudes for coefficients weights are convex, so that a difference quotient is
        above the derivative, which is above all derivatives.
        """
        units = self._units
        if not units.any():
            return np.zeros_like(sizes)
        x = np.abs(self._floats) + units * (_PROBE / units.max())
        wide = conditions.weights_at(self.layout, x, order, independent=True)
        # of huge coefficients no numbers, and no decision
        with np.errstate(over="ignore", invalid="ignore"):
            quotient: NDArray[np.float64] = (wide - sizes + _DOUBLE_ROUNDING * wide) / _PROBE
            quotient *= 2 * TOLERANCE_FACTOR * units.max()
        return quotient

    @property
    def _units(self) -> NDArray[np.float64]:
        # those beyond doubles aren't nothing
        units = [coefficient.unit for coefficient in self.coefficients]
        return np.array([max(float(unit), _MIN_UNIT) if unit else 0.0 for unit in units])

    def tolerance(self, order: int) -> NDArray[np.float64]:
        """Return what residuals may be for all that the stored places can tell.

        Parameters
        ----------
        order : int

        Returns
        -------
        ndarray, shape (conditions.count(order, independent=True),)
            As in `exact_order`; zeros for rational coefficients.
        """
        units = self._units
        if not units.any():
            return np.zeros(conditions.count(order, independent=True))
        jacobian = conditions.jacobian_at(self.layout, self._floats, order, independent=True)
        tolerance: NDArray[np.float64] = TOLERANCE_FACTOR * (np.abs(jacobian) @ units)
        return tolerance

    def _check_nominal_order(self, error: type[MethodError]) -> None:
        assert self.nominal_residual is not None
        try:
            residuals = conditions.residuals_at(self.layout, self._floats, self.order)
        except (TypeError, ValueError) as problem:
            raise error(f"nominal_order: {problem}") from None
        largest = float(np.abs(residuals).max())
        if not largest <= float(self.nominal_residual.value):
            raise error(
                f"nominal_order {self.order} is not borne out: its residuals reach {largest:.3g}, "
                f"more than nominal_residual = {self.nominal_residual.text}"
            )


def _frozen(numbers: Any) -> NDArray[np.float64]:
    array = np.array(numbers, dtype=np.float64)
    array.flags.writeable = False
    return array


def read_coefficient(
    number: Any, label: str, error: type[MethodError] = MethodError
) -> Coefficient:
    """Return a number with its text, checked to be one that a double can stand for."""
    try:
        coefficient = Coefficient.read(number)
        float(coefficient.value)
    except ValueError as problem:
        raise error(f"{label}: {problem}") from None
    except OverflowError:
        raise error(f"{label}: {number} is beyond the range of doubles") from None
    return coefficient


def read_texts(
    name: Any, source: Any, nominal: Sequence[Any], error: type[MethodError] = MethodError
) -> dict[str, Any]:
    """Return the fields that all methods have, checked; `nominal` are order and residual."""
    for label, text in (("name", name), ("source", source)):
        if not isinstance(text, str):
            raise error(f"{label} must be a str, got {text!r}")
        if any("\ud800" <= letter <= "\udfff" for letter in text):
            raise error(f"{label} must be text, got {text!r}, which no encoding can hold")
    order, residual = nominal
    if order is not None:
        try:
            order = check_integer("order", order, 1)
        except (TypeError, ValueError) as problem:
            raise error(f"nominal_order: {problem}") from None
    if (order is None) != (residual is None):
        raise error("nominal_order and nominal_residual must be given together")
    if residual is not None:
        residual = read_coefficient(residual, "nominal_residual", error)
    return {"name": name, "source": source, "nominal_order": order, "nominal_residual": residual}


def remembered(compute: Callable[[Method], Result]) -> Callable[[Method], Result]:
    """Return a function that computes something of a method once, as long as the method lives.

    Methods are frozen. They are told apart as objects: to hash all their coefficients would take
    longer than most of what is computed.
    """
    known: dict[int, Result] = {}

    @wraps(compute)
    def recall(method: Method) -> Result:
        key = id(method)
        if key not in known:
            known[key] = compute(method)
            weakref.finalize(method, known.pop, key, None)
        return known[key]

    return recall
