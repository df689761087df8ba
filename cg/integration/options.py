"""Keyword arguments that the integrations share; `cg.solve_ivp` documents them."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable
from typing import Any, TypedDict, TypeVar

from numpy.typing import ArrayLike

from cg.integration.default_method import AUTO
from cg.integration.rhs.samples import Samples
from cg.support.checks import similar_names
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
    inputs: Samples | tuple[Samples, ...] | None
    args: Iterable[Any] | None
    parameters: ArrayLike | None
    rhs: str


class Options(StepOptions, total=False):
    """Options of integrations over a given span of time."""

    max_steps: int | None
    t_eval: ArrayLike | None
    dense_output: bool
    events: Any
    observe: Any
    store: str


_DEFAULTS: dict[str, Any] = dict.fromkeys(Options.__annotations__) | {
    "method": AUTO,
    "rhs": "coefficients",
    "max_step": math.inf,
    "dense_output": False,
    "store": "all",
}


def complete_options(
    function: Callable[..., Any],
    positional: tuple[Any, ...],
    options: StepOptions,
    kind: type = Options,
) -> Options:
    """Return the options of a call of ``function`` with the defaults of those that aren't given.

    TypeError is raised for other names, and for more positional arguments than it takes.
    """
    if positional or not options.keys() <= kind.__annotations__.keys():
        name = function.__qualname__.removesuffix(".__init__")
        if positional:
            raise TypeError(
                f"{name}() takes method and all options by keyword, such as "
                f"method={positional[0]!r}, got {len(positional)} too many positional arguments"
            )
        wrong = next(iter(options.keys() - kind.__annotations__.keys()))
        parameters = inspect.signature(function).parameters.values()
        names = [each.name for each in parameters if each.kind == each.KEYWORD_ONLY]
        hint = similar_names(wrong, names) or f"; the options are {', '.join(names)}"
        raise TypeError(f"{name}() got an unexpected keyword argument {wrong!r}{hint}")
    complete: Any = {**_DEFAULTS, **options}
    return complete  # type: ignore[no-any-return]


def expand_options(function: _Function) -> _Function:
    """Show the options one by one in the signature of a function that takes ``**options``."""
    signature = inspect.signature(function)
    parameters = list(signature.parameters.values())
    kind = StepOptions if "StepOptions" in str(parameters.pop().annotation) else Options
    parameters = [each for each in parameters if each.kind != each.VAR_POSITIONAL]
    first = [parameter.name for parameter in parameters].index("frame") + 1
    parameters[first:first] = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=_DEFAULTS[name],
            annotation=getattr(annotation, "__forward_arg__", annotation),
        )
        for name, annotation in kind.__annotations__.items()
    ]
    changed: Any = function
    changed.__signature__ = signature.replace(parameters=parameters)
    # without it, a misspelt keyword gets a better message than that frame is missing
    changed.__kwdefaults__ = {"frame": None, **(changed.__kwdefaults__ or {})}
    return function
