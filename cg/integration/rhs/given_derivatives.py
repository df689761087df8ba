"""Functions of the user that return derivatives of a right-hand side: ``jac`` and ``df_dp``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cg.frames.base import Frame
from cg.frames.phase_space import PhaseSpace
from cg.integration.rhs.checks import read_finite
from cg.integration.rhs.compiled import CompiledRhs, compiled_rhs
from cg.integration.rhs.inputs import Inputs, WithInput
from cg.support.arrays import Array, Points


@dataclass(frozen=True, eq=False)
class Derivative:
    """A function of the user, in Python or compiled, with the arguments of ``f``."""

    name: str
    function: Any  # a `CompiledRhs` if it is compiled
    frame: Frame
    shape: tuple[int, ...]  # shape of its value at one point
    vectorized: bool = False  # whether it takes several points in one call

    def __call__(self, t: Any, y: Points, arguments: tuple[Any, ...], data: int = 0) -> Array:
        """Return the derivatives; a compiled function without its own data receives ``data``."""
        if isinstance(self.function, CompiledRhs):
            own = self.function.user_data or data
            return self.check(self.function.values(self.frame, own, t, y[None], self.shape)[0], t)
        return self.check(self.function(t, read_only(y), *arguments), t)

    def check(self, value: Any, t: Any, _: Any = None) -> Array:
        """Return the value of the function as a C-ordered array, after checking it."""
        expected = (len(t), *self.shape) if self.vectorized else self.shape
        return read_finite(value, self.name, expected, t, number=True)


def derivative_of(
    function: Any,
    name: str,
    frame: Frame,
    shape: tuple[int, ...],
    vectorized: bool,
    inputs: Inputs | None,
    kind: type[Derivative] = Derivative,
) -> Derivative | None:
    """Return a function that the user gave, after checking it, or None."""
    compiled = compiled_rhs(function, name)
    if compiled is not None and vectorized:
        raise ValueError(f"vectorized must be False for a compiled {name}, which takes one point")
    if compiled is None:
        if function is None:
            return None
        if not callable(function):
            raise TypeError(f"{name} must be callable as {name}(t, y), got {function!r}")
    if isinstance(frame, PhaseSpace) and kind is Derivative:
        # f returns forces, and derivatives would be those of all coefficients
        raise ValueError(
            f"{name} must be None on a phase space, where derivatives are differences, got "
            f"{function!r}"
        )
    if compiled is None and inputs is not None:
        function = WithInput(function)
    return kind(name, compiled or function, frame, shape, vectorized)


def read_only(y: Points) -> Points:
    """Return a view that a function of the user can't write to."""
    view = y.view()
    view.flags.writeable = False
    return view
