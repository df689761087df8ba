"""Functions of later parts of the package as methods of earlier ones, imported when used."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import MethodType
from typing import Any

__all__ = ["Later"]


class Later:
    """A function that takes an object as its first argument, as a method of the object's class.

    What a method is knows nothing of proofs, and yet `Method.digits` gives proved digits. The
    module of the function is imported when it is first asked for.

    Parameters
    ----------
    module, name : str
        Where the function is.
    of_class : bool, optional
        Whether its first argument is the class itself.
    """

    def __init__(self, module: str, name: str, *, of_class: bool = False) -> None:
        self._module = module
        self._name = name
        self._of_class = of_class

    def __get__(self, owner: object, kind: type | None = None) -> Callable[..., Any]:
        function: Callable[..., Any] = getattr(import_module(self._module), self._name)
        if self._of_class:
            return MethodType(function, kind)
        return function if owner is None else MethodType(function, owner)
