"""A StopIteration of the user's function ends the call as what it is.

Python makes a RuntimeError of one that leaves a generator, and steps come from generators.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

__all__ = ["keeping_stop_iteration"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def keeping_stop_iteration(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Raise the StopIteration that ended a generator of this package, as it was."""

    @wraps(function)
    def call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        try:
            return function(*args, **kwargs)
        except RuntimeError as error:
            if isinstance(error.__cause__, StopIteration) and _made_here(error):
                raise error.__cause__ from None
            raise

    return call


def _made_here(error: RuntimeError) -> bool:
    """Tell whether a generator of this package was left, not one of the user's."""
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    return at is not None and str(at.tb_frame.f_globals.get("__name__", "")).startswith("cg.")
