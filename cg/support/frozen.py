"""Frozen dataclasses: read-only arrays in copies, and objects made without a call of the class."""

from typing import Any, TypeVar

import numpy as np

Result = TypeVar("Result")


class ReadOnly:
    """Keeps read-only arrays read-only in copies."""

    def __getstate__(self) -> dict[str, Any]:
        fixed = [
            name
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray) and not value.flags.writeable
        ]
        return {**vars(self), "fixed": fixed}

    def __setstate__(self, state: dict[str, Any]) -> None:
        fixed = state.pop("fixed")
        vars(self).update(state)
        for name in fixed:
            state[name].setflags(write=False)


def filled(kind: type[Result], fields: dict[str, Any]) -> Result:
    """Return an object of a frozen dataclass whose ``__dict__`` is ``fields``.

    Fields that are left out have the defaults of the class. This is much faster than a call of it.
    """
    instance = object.__new__(kind)
    object.__setattr__(instance, "__dict__", fields)
    return instance


def changed(instance: Result, **fields: Any) -> Result:
    """Return an object of a frozen dataclass with other values of some fields, faster than replace.

    ``__post_init__`` isn't called. TypeError is raised for a name that isn't that of a field.
    """
    kind: Any = type(instance)
    if not fields.keys() <= kind.__dataclass_fields__.keys():
        wrong = fields.keys() - kind.__dataclass_fields__.keys()
        raise TypeError(f"{kind.__name__} has no fields of the names {sorted(wrong)}")
    return filled(type(instance), vars(instance) | fields)
