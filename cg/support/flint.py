"""The types of python-flint, which is imported when one of them is first used.

Without python-flint searches, proofs, digits, order conditions in balls, limits of stability and
reference solutions raise an ImportError that says what to install. Rationals are then Fractions,
which are slower; see `cg.support.quads.to_flint`.
"""

from __future__ import annotations

from typing import Any


class MissingFlintError(ImportError):
    """A function needs python-flint, which isn't installed."""


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # names that imports look up in a module
        raise AttributeError(name)
    try:
        import flint
    except ModuleNotFoundError as error:
        raise MissingFlintError(
            "searches, proofs, digits, order conditions in balls, limits of stability and "
            "reference solutions need the extra [proofs]: python -m pip install python-flint",
            name="flint",
        ) from error
    value = globals()[name] = getattr(flint, name)
    return value
