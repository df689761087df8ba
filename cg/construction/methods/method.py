"""The base class of all methods: points, flows, the flat tableau, order and residuals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from fractions import Fraction
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from cg.construction import conditions
from cg.construction.layouts import Layout, check_length
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.tolerance import satisfies, to_floats, tolerance
from cg.construction.points import FlatSums, MethodError, Point, PointTree
from cg.support.arrays import read_only
from cg.support.checks import check_flag, check_integer
from cg.support.parsing import visible
from cg.tables import MethodTable, stored_table

ExactTableau = tuple[tuple[tuple[Fraction, ...], ...], tuple[Fraction, ...]]

_MAX_SHOWN = 200  # coefficients of a method whose repr computes the order: half a second


class Method(ABC):
    """A Runge–Kutta method on manifolds: a tree of points with exact coefficients.

    Methods are immutable. They keep all coefficients as they were given; numbers derived from them
    are exact or correctly rounded. The subclasses are `cg.Tableau`, `cg.CommutatorFree`,
    `cg.MuntheKaas`, `cg.MagnusMethod` and `cg.Splitting`.

    Attributes
    ----------
    name, source
        Name and origin of the method.
    third_weights
        The weights of the third result of a pair that has one; see `cg.CommutatorFree`.
    nominal_order
        The intended order of a method that satisfies its order conditions only approximately.
    nominal_residual
        Upper bound of the absolute residuals through `nominal_order`.
    tree
        The points of a step. Points of an implicit method depend on the unknown stages.
    coefficients
        All coefficients, packed as `layout` describes.
    file
        The file that `cg.load` read the method from; None for other methods. Its certificate may
        lie beside it. It isn't compared or pickled.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> method = cg.methods["CF4"]
    >>> isinstance(method, cg.Method), method.order, method.stages, method.exponentials
    (True, 4, 4, 5)
    """

    name: str
    source: str
    file: Path | None = None
    third_weights: tuple[Coefficient, ...] | None = None
    nominal_order: int | None = None
    nominal_residual: Coefficient | None = None
    of_trees: ClassVar[bool] = True  # whether its order conditions are those of ordered trees
    stored: ClassVar[bool] = False  # whether its table is, as those of the catalogue are
    _COUNTED: ClassVar = ("evaluation", "flow")  # stages and exponentials, in words

    if TYPE_CHECKING:  # fields in some subclasses, cached properties in others

        @property
        def tree(self) -> PointTree:
            """The points of a step."""

        @property
        def coefficients(self) -> tuple[Coefficient, ...]:
            """All coefficients."""

    @property
    @abstractmethod
    def layout(self) -> Layout:
        """Positions of the weights in `coefficients`."""

    @property
    @abstractmethod
    def embedded(self) -> Self | None:
        """The method of the second result of a pair; None without it."""

    def with_coefficients(self, coefficients: Sequence[Any], **fields: Any) -> Self:
        """Return the method with other coefficients in the same places.

        Parameters
        ----------
        coefficients
            Sequence of numbers. As many as `coefficients`, in the same sequence.
        **fields
            Further keyword arguments of the class. `name` and `source` are those of this method
            by default; third weights, but for a Magnus method, and a nominal order are left out by
            default.

        Raises
        ------
        ValueError
            If there are too few or too many coefficients.
        MethodError
            If the method would be wrong; of tableaux a `TableauError`.

        Examples
        --------
        >>> import crouch_grossman as cg
        >>> cg.methods["CG2"].with_coefficients(["2/3", "1/4", "3/4"], name="Ralston")
        <Tableau Ralston: order 2, 2 evaluations, 3 flows>
        """
        check_length(coefficients, len(self.coefficients))
        return self._with(coefficients, **({"name": self.name, "source": self.source} | fields))

    @abstractmethod
    def _with(self, coefficients: Sequence[Any], **fields: Any) -> Self:
        """Return the method with as many other coefficients and with arguments of its class."""

    @property
    @abstractmethod
    def _key(self) -> tuple[Any, ...]:
        """The numbers in which equal methods of a class agree."""

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone: cached arrays would come back writeable."""
        return {field.name: self.__dict__[field.name] for field in fields(cast(Any, self))}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Method):
            return NotImplemented
        return type(self) is type(other) and self._key == other._key

    def __hash__(self) -> int:
        return hash((type(self), self._key))

    def __repr__(self) -> str:
        name = visible(self.name) or "without name"
        return f"<{type(self).__name__} {name}: {self.description()}>"

    def description(self, *, complete: bool = False) -> str:
        """Return order, evaluations and flows in words.

        Parameters
        ----------
        complete
            Include the order even if it takes seconds to compute. By default, the order of a
            method with more than 200 coefficients is left out unless it is cached.

        Examples
        --------
        >>> import crouch_grossman as cg
        >>> cg.methods["CF5(4)"].description()
        'order 5(4), 7 evaluations, 9 flows'
        """
        complete = check_flag("complete", complete)
        counts = zip((self.stages, self.exponentials), self._COUNTED, strict=True)
        phrases = [f"{count} {label}{'s' * (count != 1)}" for count, label in counts]
        if complete or len(self.coefficients) <= _MAX_SHOWN or "exact_order" in self.__dict__:
            phrases.insert(0, f"order {self._order_in_words}")
        elif self.exact_embedded is not None:
            phrases.append("a pair")
        if not self.explicit:
            phrases.append("implicit")
        return ", ".join(phrases)

    @property
    def _order_in_words(self) -> str:
        pair = "" if self.embedded_order is None else f"({self.embedded_order})"
        return f"{self.order}{pair}{' (nominal)' * self.approximate}"

    def table(self) -> MethodTable:
        """Return the constants that integrations read, compiled once."""
        return stored_table(self.name) if self.stored else self._compiled

    @cached_property
    def _compiled(self) -> MethodTable:
        # the compiler knows all classes of methods, which are derived from this one
        table: MethodTable = import_module("cg.construction.methods.compile").compiled(self)
        return table

    @property
    def explicit(self) -> bool:
        """Whether each stage depends on earlier stages only."""
        return True

    @property
    def _explicit_tree(self) -> PointTree:
        if not self.explicit:
            raise AttributeError(f"{self!r} is implicit, so that its stages are not points")
        return self.tree

    @property
    def points(self) -> tuple[Point, ...]:
        """The points of a step of an explicit method, parents first; see `Point`."""
        return self._explicit_tree.points

    @property
    def stage_points(self) -> tuple[int, ...]:
        """The point of each stage, -1 for the initial point."""
        return self._explicit_tree.stage_points

    @property
    def result(self) -> int:
        """The point that is the result of a step."""
        return self._explicit_tree.result

    @property
    def embedded_result(self) -> int | None:
        """The point that is the second result of a pair; None without it."""
        return self._explicit_tree.embedded_result

    @property
    def advancing_results(self) -> tuple[int, ...]:
        """The points of the results, first that of higher order, with which steps advance."""
        ends = self.tree.results
        return ends[::-1] if (self.embedded_order or 0) > self.order else ends

    @property
    def stages(self) -> int:
        """Number of stages s: evaluations of the right-hand side in a step."""
        return len(self.tree.stage_points)

    @cached_property
    def exponentials(self) -> int:
        """Number of flows of a step.

        Initial flows that several stages share count once, and so do points that are equal. Flows
        to the second result of a pair don't count; see `pair_exponentials`.
        """
        return self.tree.flows([*self.tree.stage_points, self.tree.result])

    @property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Weights of error estimates that are combinations of values at stages."""
        return ()

    @property
    def third_order(self) -> int | None:
        """Order of the third weights of a pair; None without them."""
        return None

    @property
    def third_flow(self) -> tuple[Coefficient, ...] | None:
        """The weights of the flow to a third result, which an error estimate uses, or None."""
        return None

    @cached_property
    def pair_exponentials(self) -> int:
        """Number of flows of a step with its error estimate.

        These are `exponentials`, the flows to the second result, and that to a third one.
        """
        tree = self.tree
        if not self.explicit:
            return self.exponentials + sum(entry != 0 for entry in self.exact_embedded or ())
        second = [] if tree.embedded_result is None else [tree.embedded_result]
        flows = tree.flows([*tree.stage_points, tree.result, *second])
        return flows + (self.third_flow is not None)

    @cached_property
    def exact(self) -> ExactTableau:
        """``(a, b)`` as tuples of Fractions, shapes (s, s) and (s,): the flat tableau.

        If flows commute, the method is the classical method with this tableau. Only a
        `cg.Tableau` is determined by it.
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
        """Stage coefficients of `exact`, rounded to double; shape (s, s), read-only.

        Functions of tableaux such as `cg.conditions.residuals` refuse them unless the method is a
        `cg.Tableau`.
        """
        sums = FlatSums((self.stages, self.stages))
        sums[...] = np.array(self.exact[0], dtype=np.float64)
        sums.setflags(write=False)
        return sums.view(np.ndarray)

    @cached_property
    def b(self) -> NDArray[np.float64]:
        """Weights of `exact`, rounded to double; shape (s,), read-only."""
        return frozen(self.exact[1])

    @cached_property
    def b_embedded(self) -> NDArray[np.float64] | None:
        """Second weights of a pair, rounded to double; shape (s,), read-only; None without."""
        return None if self.exact_embedded is None else frozen(self.exact_embedded)

    @cached_property
    def abscissae(self) -> tuple[Fraction, ...]:
        """The times of stages as fractions of a step: the sums of the rows of `exact`."""
        return tuple(sum(row, Fraction(0)) for row in self.exact[0])

    @cached_property
    def c(self) -> NDArray[np.float64]:
        """The `abscissae`, rounded to double; shape (s,), read-only."""
        return frozen(self.abscissae)

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
        """The order of the method, up to the rounding of its coefficients.

        The largest q (0 to ``conditions.MAX_ORDER``) such that every condition through
        order q has an exact residual no larger than `TOLERANCE_FACTOR` times
        ``Σ_k |∂Φ/∂x_k| u_k``, where u_k is the uncertainty of coefficient k
        (`Coefficient.unit`). The tolerance is 0 for rational coefficients.
        """
        orders = range(1, conditions.MAX_ORDER + 1)
        return next((q - 1 for q in orders if not self.satisfies(q)), orders[-1])

    def residuals(self, order: int) -> Sequence[Any]:
        """Return the exact residuals ``Φ(t) - 1/γ(t)`` of all trees through an order.

        Returns
        -------
        tuple of Fraction
            One for each of the ordered trees `cg.conditions.condition_trees`; a `cg.MuntheKaas` has
            the classical residuals. A `cg.MagnusMethod` has Decimals of 50 digits, one for each
            word; see `cg.Splitting.residuals` too.

        Examples
        --------
        >>> import crouch_grossman as cg
        >>> trees = map(cg.construction.trees.forest(5).tree, cg.conditions.condition_trees(4))
        >>> residuals = cg.methods["CG3"].residuals(4)
        >>> [str(t) for t, r in zip(trees, residuals, strict=True) if abs(r) > 0.05]
        ['[[][[[]]]]', '[[[[]]][]]']
        """
        return conditions.residuals(self.tree, order, arithmetic="exact")

    def max_residual(self, order: int | None = None) -> float:
        """Return the magnitude of the largest residual through an order.

        Parameters
        ----------
        order
            By default the method's own order, or 1 if it has none.
        """
        return float(max(map(abs, self.residuals(max(self.order, 1) if order is None else order))))

    @cached_property
    def principal_error(self) -> float:
        """Euclidean norm of the residuals of order q + 1, q the order: all trees, q + 2 nodes.

        A ValueError if q is ``conditions.MAX_ORDER``.
        """
        compute: Any = self.residuals
        if self.of_trees:  # in double precision
            compute = partial(conditions.residuals, self.tree)
        lower = len(compute(self.order)) if self.order else 0
        return float(np.linalg.norm(np.array(compute(self.order + 1)[lower:], dtype=np.float64)))

    def satisfies(self, order: int) -> bool:
        """Return whether the conditions through an order hold, up to the rounding of coefficients.

        The tolerance is that of `exact_order`.
        """
        order = check_integer("order", order, 1)
        return satisfies(self.tree, self.layout, self.coefficients, order)

    def tolerance(self, order: int) -> NDArray[np.float64]:
        """Return the largest residuals through an order that rounded coefficients may cause.

        Returns
        -------
        ndarray, shape (conditions.count(order, independent=True),)
            See `exact_order`; zeros for rational coefficients.
        """
        return tolerance(self.layout, self.coefficients, order)

    def _check_nominal_order(self) -> None:
        """Raise MethodError if residuals through a nominal order exceed the nominal residual."""
        if self.nominal_residual is None:
            return
        try:
            residuals = conditions.residuals(self.layout, to_floats(self.coefficients), self.order)
        except (TypeError, ValueError) as problem:
            raise MethodError(f"nominal_order: {problem}") from None
        largest = float(np.abs(residuals).max())
        if not largest <= float(self.nominal_residual.value):
            raise MethodError(
                f"residuals through nominal_order {self.order} reach {largest:.3g}, "
                f"more than nominal_residual = {float(self.nominal_residual.value):.3g}"
            )

    @property
    def _embedded_names(self) -> dict[str, Any]:
        """Name and source of `embedded`."""
        return {"name": f"{self.name}, embedded" * bool(self.name), "source": self.source}

    @cached_property
    def embedded_order(self) -> int | None:
        """Order of the embedded method, computed like `exact_order`; None without."""
        return None if self.embedded is None else self.embedded.exact_order

    def use_stored(self, order: int, embedded_order: int | None) -> None:
        """Take the stored table, and orders that were computed before unless they are nominal."""
        vars(self)["stored"] = True
        if not self.approximate:
            vars(self).update(exact_order=order, embedded_order=embedded_order)
            if self.embedded is not None:
                vars(self.embedded)["exact_order"] = embedded_order


def frozen(numbers: Any) -> NDArray[np.float64]:
    """Return numbers as a read-only array of doubles."""
    return read_only(np.array(numbers, dtype=np.float64))
