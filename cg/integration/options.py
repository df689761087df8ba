"""Keyword arguments that the integrations share; `cg.solve_ivp` documents them."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable
from typing import Any, TypedDict, TypeVar

from numpy.typing import ArrayLike

from cg.integration.default_method import AUTO
from cg.integration.langevin import Langevin
from cg.integration.plan.stage_solver import DEFAULT_STAGE_SOLVER
from cg.integration.rhs.function import Function
from cg.integration.rhs.samples import Samples
from cg.support.checks import similar_names
from cg.support.executors import ExecutorLike
from cg.tables import HasTable

_Function = TypeVar("_Function", bound=Callable[..., Any])


class StepOptions(TypedDict, total=False):
    """Options of all integrations, also of a `cg.Stepper`."""

    method: str | HasTable
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
_DEFAULTS: dict[str, Any] = dict.fromkeys(EnsembleOptions.__annotations__) | {
    "method": AUTO,
    "rhs": "coefficients",
    "max_step": math.inf,
    "stage_solver": DEFAULT_STAGE_SOLVER,
    "vectorized": False,
    "dense_output": False,
    "store": "all",
    "linear": False,
    "control_derivatives": False,
    "common_steps": False,
}


def complete_options(
    function: Any, positional: tuple[Any, ...], options: StepOptions
) -> EnsembleOptions:
    """Return the options of a call of ``function`` with the defaults of those that aren't given.

    TypeError is raised for other names, and for more positional arguments than it takes.
    """
    if positional or not options.keys() <= function.options.keys():
        name = function.__qualname__.removesuffix(".__init__")
        if positional:
            key = "method" if isinstance(positional[0], str) else "frame"
            raise TypeError(
                f"{name}() takes {key} and all options by keyword, such as "
                f"{key}={positional[0]!r}, got {len(positional)} too many positional arguments"
            )
        wrong = next(iter(options.keys() - function.options.keys()))
        parameters = inspect.signature(function).parameters.values()
        names = [each.name for each in parameters if each.kind == each.KEYWORD_ONLY]
        hint = similar_names(wrong, names) or f"; the options are {', '.join(names)}"
        raise TypeError(f"{name}() got an unexpected keyword argument {wrong!r}{hint}")
    complete: Any = {**_DEFAULTS, **function.options, **options}
    return complete  # type: ignore[no-any-return]


def expand_options(**defaults: Any) -> Callable[[_Function], _Function]:
    """Show the options one by one in the signature of a function that takes ``**options``.

    ``defaults`` are those of the function that differ from the others'.
    """

    def expand(function: _Function) -> _Function:
        signature = inspect.signature(function)
        parameters = list(signature.parameters.values())
        name = parameters.pop().annotation.removeprefix("Unpack[").removesuffix("]")
        kind = next(kind for kind in _KINDS if kind.__name__ == name)
        options = {name: _DEFAULTS[name] for name in kind.__annotations__} | defaults
        parameters = [each for each in parameters if each.kind != each.VAR_POSITIONAL]
        first = [parameter.name for parameter in parameters].index("frame") + 1
        parameters[first:first] = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=options[name],
                annotation=getattr(annotation, "__forward_arg__", annotation),
            )
            for name, annotation in kind.__annotations__.items()
        ]
        changed: Any = function
        changed.options = options
        changed.__signature__ = signature.replace(parameters=parameters)
        # without it, a misspelt keyword gets a better message than that frame is missing
        changed.__kwdefaults__ = {"frame": None, **(changed.__kwdefaults__ or {})}
        return function

    return expand
