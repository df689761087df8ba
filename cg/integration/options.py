"""Options of the integrations, which `cg.solve_ivp` documents: names, types and defaults."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable
from os import PathLike
from typing import Any, TypedDict, TypeVar

from numpy.typing import ArrayLike

from cg.integration.default_method import AUTO
from cg.integration.heat_bath import Langevin
from cg.integration.rhs.function import Function
from cg.integration.rhs.samples import Samples
from cg.support.checks import check_flag, similar_names
from cg.support.parallel import ExecutorLike
from cg.tables import HasTable

Decorated = TypeVar("Decorated", bound=Callable[..., Any])


class StepOptions(TypedDict, total=False):
    """Options of all integrations, also of a `cg.Stepper`."""

    method: str | PathLike[str] | HasTable
    h: float | None
    rtol: ArrayLike | None
    atol: ArrayLike | None
    max_step: float
    first_step: float | None
    breakpoints: ArrayLike | None
    events: Any
    inputs: Samples | tuple[Samples, ...] | list[Any] | None
    args: Iterable[Any] | None
    parameters: ArrayLike | None
    rhs: str
    stage_solver: str
    jac: Function | ArrayLike | None
    vectorized: bool
    thermostat: Langevin | None
    step_function: Any


class Options(StepOptions, total=False):
    """Options of integrations over a given span of time."""

    max_steps: int | None
    t_eval: ArrayLike | None
    dense_output: bool
    observe: Any
    store: str
    linear: bool
    derivatives: str | None
    derivatives_by: str | ArrayLike | None
    df_dp: Function | None
    P0: ArrayLike | None
    noise: ArrayLike | Function | None
    control_derivatives: bool
    progress: Callable[[float, float], None] | None


class EnsembleOptions(Options, total=False):
    """Options of integrations of many members."""

    common_steps: bool
    inertia: Any
    executor: ExecutorLike
    workers: int | None
    out: Any


_KINDS = (StepOptions, Options, EnsembleOptions)
_HINTS = {
    **dict.fromkeys(EnsembleOptions.__annotations__, "; cg.solve_ensemble takes it"),
    **dict.fromkeys(Options.__annotations__, "; cg.solve_ivp takes it"),
    "save_every": "; cg.integrate takes it",
    "dense": "; the option is called dense_output",
    "dt": "; the option is called h",
}
_FLAGS = ("linear", "vectorized", "common_steps", "dense_output", "control_derivatives")
"""Options that are True or False, by default False."""
_DEFAULTS: dict[str, Any] = {
    **dict.fromkeys(EnsembleOptions.__annotations__),
    **dict.fromkeys(_FLAGS, False),
    "method": AUTO,
    "rhs": "coefficients",
    "max_step": math.inf,
    # Newton's method takes fewer evaluations on the free rigid body than the fixed-point iteration:
    # 9 instead of 11 in a step whose corrections decrease by a factor of 20, 13 instead of 18 by 5.
    "stage_solver": "newton",
    "store": "all",
}


def complete_options(function: Any, options: StepOptions) -> EnsembleOptions:
    """Return the options of a call of ``function`` with the defaults of those that aren't given.

    TypeError is raised for other names, and for flags that aren't True or False.
    """
    if not options.keys() <= function.options.keys():
        caller = function.__qualname__.removesuffix(".__init__")
        wrong = next(name for name in options if name not in function.options)
        names = [*function.__kwdefaults__, *function.options]
        hint = _HINTS.get(wrong) or similar_names(wrong, names)
        hint = hint or f"; the options are {', '.join(names)}"
        raise TypeError(f"{caller}() got an unexpected keyword argument {wrong!r}{hint}")
    given: Any = options
    for name in function.required:
        if name in options and (given[name] is None or given[name] is False):
            raise ValueError(f"{name} must not be {given[name]} in {function.__qualname__}")
    complete: Any = function.complete.copy()
    complete.update(options)
    for name in options:
        if name in _FLAGS:
            complete[name] = check_flag(name, complete[name])
    return complete  # type: ignore[no-any-return]


def expand_options(**defaults: Any) -> Callable[[Decorated], Decorated]:
    """Show the options one by one in the signature of a function that takes ``**options``.

    ``defaults`` are the defaults of this function that differ from `_DEFAULTS`.
    """

    def expand(function: Decorated) -> Decorated:
        signature = inspect.signature(function)
        *parameters, unpacked = signature.parameters.values()
        kind = next(kind for kind in _KINDS if unpacked.annotation == f"Unpack[{kind.__name__}]")
        options = {name: _DEFAULTS[name] for name in kind.__annotations__} | defaults
        index = [parameter.name for parameter in parameters].index("frame") + 1
        parameters[index:index] = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=options[name],
                annotation=getattr(annotation, "__forward_arg__", annotation),
            )
            for name, annotation in kind.__annotations__.items()
        ]
        target: Any = function
        target.options, target.required = options, set(defaults)
        target.complete = _DEFAULTS | options  # with options of other functions
        target.__signature__ = signature.replace(parameters=parameters)
        # a misspelt keyword gets its better message before a missing frame gets one
        target.__kwdefaults__ = {"frame": None, **(target.__kwdefaults__ or {})}
        return function

    return expand
