"""Splitting methods: compositions of drifts and kicks for mechanical systems."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import accumulate, chain, count
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions.linear_equations import nystrom_residuals, nystrom_values
from cg.construction.methods.coefficients import Coefficient, read_row, read_texts, values_of
from cg.construction.methods.method import Method, frozen
from cg.construction.methods.tolerance import TOLERANCE_FACTOR
from cg.support.checks import check_integer
from cg.support.quads import to_flint, to_fraction

if TYPE_CHECKING:
    from cg.support.flint import fmpq


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Splitting(Method):
    r"""A splitting method for mechanical systems, H = T + V [1]_.

    A step with step size h follows the free motion (drift) for d_0 h, changes the momentum (kick)
    by k_0 h times the force, and so on,

    .. math::

        \varphi^T_{d_0 h}, \varphi^V_{k_0 h}, \varphi^T_{d_1 h}, \dots,
        \varphi^V_{k_{s-1} h}, \varphi^T_{d_s h} .

    The method is explicit, symplectic where the force is that of a potential, and reversible if it
    is symmetric. The kinetic energy T must be quadratic in the momentum.

    Parameters
    ----------
    drifts
        Sequence of s + 1 numbers. The drifts d, as `Coefficient.read` takes them. The first and the
        last may be zero. Then the force of the last kick of a step serves the first kick of the
        next.
    kicks
        Sequence of s numbers. The kicks k.
    name, source
        Name and origin of the method.

    Attributes
    ----------
    drift_coefficients, kick_coefficients
        The drifts and the kicks, with their text and uncertainty.

    Raises
    ------
    MethodError
        If there is no kick, there isn't one drift more than there are kicks, or an entry is no
        finite number.

    References
    ----------
    .. [1] S. Blanes, F. Casas, A. Murua, "Splitting methods for differential equations", Acta
       Numerica 33 (2024), 1-161.

    Examples
    --------
    >>> leapfrog = Splitting([0, 1, 0], ["1/2", "1/2"], name="kick, drift, kick")
    >>> leapfrog.order, leapfrog.stages, leapfrog.exponentials, leapfrog.symmetric
    (2, 2, 1, True)
    """

    name: str
    source: str
    drift_coefficients: tuple[Coefficient, ...]
    kick_coefficients: tuple[Coefficient, ...]
    of_trees: ClassVar[bool] = False
    _COUNTED: ClassVar = ("kick", "drift")
    embedded = exact_embedded = None  # there is no second result

    def __init__(
        self, drifts: Iterable[Any], kicks: Iterable[Any], *, name: str = "", source: str = ""
    ) -> None:
        values = read_texts(name, source)
        values["kick_coefficients"] = read_row(kicks, "kicks")
        count = len(values["kick_coefficients"])
        values["drift_coefficients"] = read_row(drifts, "drifts", count + 1)
        vars(self).update(values)

    def _with(self, coefficients: Sequence[Any], **fields: Any) -> Splitting:
        return Splitting(coefficients[::2], coefficients[1::2], **fields)

    @property
    def _key(self) -> tuple[Any, ...]:
        return values_of(self.drift_coefficients), values_of(self.kick_coefficients)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """Drifts and kicks in the order of a step, the first drift first."""
        pairs = zip(self.drift_coefficients, self.kick_coefficients, strict=False)
        return *chain.from_iterable(pairs), self.drift_coefficients[-1]

    @cached_property
    def drifts(self) -> NDArray[np.float64]:
        """The drifts d, rounded to double; shape (s + 1,), read-only."""
        return frozen([d.value for d in self.drift_coefficients])

    @cached_property
    def kicks(self) -> NDArray[np.float64]:
        """The kicks k, rounded to double; shape (s,), read-only."""
        return frozen([k.value for k in self.kick_coefficients])

    @property
    def b(self) -> NDArray[np.float64]:
        """The kicks, as weights of a Runge–Kutta–Nyström method; shape (s,), read-only."""
        return self.kicks

    @cached_property
    def abscissae(self) -> tuple[Fraction, ...]:
        """The times of the kicks, as fractions of a step."""
        return tuple(accumulate(d.value for d in self.drift_coefficients[:-1]))

    @property
    def tree(self) -> NoReturn:
        """A splitting method has none: AttributeError."""
        raise AttributeError(f"{self!r} has drifts and kicks, no tree of points and no tableau")

    layout = tree

    @property
    def stages(self) -> int:
        """Number of kicks s. In steps that begin and end with a kick, s - 1 evaluate the force."""
        return len(self.kick_coefficients)

    @cached_property
    def exponentials(self) -> int:
        """Number of drifts of a step that aren't zero."""
        return int(np.count_nonzero(self.drifts))

    @property
    def pair_exponentials(self) -> int:
        """Number of drifts of a step; there is no error estimate."""
        return self.exponentials

    @cached_property
    def symmetric(self) -> bool:
        """Whether drifts and kicks read backwards are the same, so that a step can be undone."""
        rows = [[x.value for x in row] for row in (self.drift_coefficients, self.kick_coefficients)]
        return all(row == row[::-1] for row in rows)

    @cached_property
    def exact_order(self) -> int:
        """The order for quadratic kinetic energies, as far as the stored places can tell."""
        return next(order - 1 for order in count(1) if not self.satisfies(order))

    def residuals(self, order: int) -> tuple[Fraction, ...]:
        """Return Σ d - 1, then the exact residuals ``Φ(t) - 1/γ(t)`` of special Nyström trees.

        Parameters
        ----------
        order
            The largest number of nodes, at least 1.
        """
        order = check_integer("order", order, 1)
        return tuple(map(to_fraction, nystrom_residuals(*self._numbers(), order)))

    def satisfies(self, order: int) -> bool:
        pairs = zip(self.residuals(order), self._allowed(order), strict=True)
        return all(abs(residual) <= bound for residual, bound in pairs)

    def tolerance(self, order: int) -> NDArray[np.float64]:
        """Return the largest residuals that rounded coefficients may cause; see `residuals`."""
        return frozen(self._allowed(check_integer("order", order, 1)))

    def _allowed(self, order: int) -> list[Fraction]:
        """Return bounds on the changes of residuals when coefficients change by up to a unit.

        They are polynomials with positive coefficients and a constant, so that their increase at
        the magnitudes is a bound.
        """
        low = nystrom_values(*self._numbers(abs), order)
        high = nystrom_values(*self._numbers(abs, units=True), order)
        return [to_fraction(TOLERANCE_FACTOR * (x - y)) for x, y in zip(high, low, strict=True)]

    def _numbers(
        self, change: Callable[[Fraction], Fraction] = Fraction, *, units: bool = False
    ) -> tuple[list[fmpq], list[fmpq]]:
        """Return drifts and kicks after a change, enlarged by their uncertainties with `units`."""

        def numbers(row: Iterable[Coefficient]) -> list[fmpq]:
            return [to_flint(change(x.value) + units * x.unit) for x in row]

        return numbers(self.drift_coefficients), numbers(self.kick_coefficients)
