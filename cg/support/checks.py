"""Checks of arguments that several modules share."""

import math
import operator
import sys
import warnings
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from numbers import Real
from typing import Any

import numpy as np

MAX_COUNT = 2**31 - 1
"""Largest count; counts are 32-bit integers in Fortran."""

NO_LIMIT = 2**62
"""A limit that no number of steps or of events reaches; both are 64-bit integers in Fortran."""

# this package, and hosts that call it
_INSIDE = {"cg", "crouch_grossman", "diffrax", "equinox", "jax", "qutip", "scipy"}
_HALF = 100  # characters of a long value in a message before and after its middle


def similar_names(name: str, names: Iterable[str]) -> str:
    """Return the names most similar to `name`, as the end of an error message, pairs first."""
    upper = {each.upper(): each for each in names}
    same = [each for key, each in upper.items() if _letters(key) == _letters(name.upper())]
    pairs = [each for key, each in upper.items() if key.startswith(f"{name.upper()}(")]
    close = [upper[key] for key in get_close_matches(name.upper(), upper, n=3, cutoff=0.5)]
    similar = dict.fromkeys(same or pairs + close)
    return f"; similar names are {', '.join(similar)}" if similar else ""


def _letters(name: str) -> str:
    return "".join(filter(str.isalnum, name))


def short(value: Any) -> str:
    """Return the representation of a value for a message, without its middle if it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 2 * _HALF else f"{text[:_HALF]} ... {text[-_HALF:]}"


def texts_of(*numbers: float) -> list[str]:
    """Return numbers for a message, with six digits or as many as tell them apart.

    A number alone, or equal ones, have all their digits.

    Examples
    --------
    >>> texts_of(0.5, 2.0), texts_of(1.7e9, 1.7e9 + 0.01)
    (['0.5', '2'], ['1700000000', '1700000000.01'])
    """
    if len(set(numbers)) == 1:
        return [repr(float(number)) for number in numbers]
    for digits in range(6, 18):
        texts = [f"{number:.{digits}g}" for number in numbers]
        if len(set(texts)) == len(set(numbers)):
            break
    return texts


def warn_user(text: str) -> None:
    """Warn at the line outside this package, and outside its hosts, that has led here."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] in _INSIDE:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)


def check_flag(name: str, value: Any) -> bool:
    """Return `value` as a bool; TypeError if it isn't True or False."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def check_instance(name: str, value: Any, kind: type) -> None:
    """Raise TypeError unless a value is one of a class."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise TypeError(f"{name} must be {article} {kind.__name__}, got {value!r}")


def check_name(name: Any) -> None:
    """Raise TypeError unless ``name`` is a non-empty string."""
    if not isinstance(name, str) or not name:
        raise TypeError(f"name must be a non-empty string, got {name!r}")


def check_choice(name: str, value: Any, choices: Collection[str]) -> None:
    """Raise TypeError unless a value is a text, ValueError unless it is one of some texts."""
    if not isinstance(value, str) or value not in choices:
        error = ValueError if isinstance(value, str) else TypeError
        raise error(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")


def check_generator(name: str, value: Any) -> np.random.Generator:
    """Return `value`; TypeError unless it is a `numpy.random.Generator`."""
    if not isinstance(value, np.random.Generator):
        raise TypeError(
            f"{name} must be a generator such as numpy.random.default_rng(0), got {value!r}"
        )
    return value


def check_number(name: str, value: Any) -> float:
    """Return a real number as a float, infinite beyond the range of doubles; else TypeError."""
    if type(value) is float:
        return value
    number = value.item() if getattr(value, "shape", None) == () else value
    if isinstance(number, bool) or not isinstance(number, Real):
        raise TypeError(f"{name} must be a real number, got {value!r}")
    try:
        return float(number)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def check_real(
    name: str, value: Any, *, positive: bool = False, infinite: bool = False,
    upper: float = math.inf,
) -> float:  # fmt: skip
    """Return `value` as a float; TypeError if it isn't a number, ValueError if out of range."""
    number = check_number(name, value)
    in_range = number > 0.0 if positive else number >= 0.0  # NaN isn't
    if not in_range or (math.isinf(number) and not infinite):
        kind = "positive" if positive else "not negative"
        raise ValueError(f"{name} must be {'' if infinite else 'finite and '}{kind}, got {value!r}")
    if number > upper:
        raise ValueError(f"{name} must be at most {upper:g}, got {value!r}")
    return number


def check_integer(name: str, value: Any, lower: int, upper: int | None = None) -> int:
    """Return `value` as an int; TypeError if it isn't one, ValueError if it is out of range."""
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        checked = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {value!r}") from None
    if checked < lower:
        raise ValueError(f"{name} must be at least {lower}, got {value}")
    if upper is not None and checked > upper:
        raise ValueError(f"{name} must be at most {upper}, got {value}")
    return checked


def check_count(name: str, value: Any) -> int:
    """Return a number of steps, positive and such that it fits counters of compiled code."""
    return min(check_integer(name, value, 1), NO_LIMIT)


def check_interval(name: str, value: Any) -> tuple[float, float]:
    """Return two numbers as floats; TypeError, or ValueError unless they are finite and grow."""
    if not isinstance(value, tuple | list | np.ndarray) or getattr(value, "ndim", 1) < 1:
        raise TypeError(f"{name} must be two increasing finite numbers, got {value!r}")
    numbers = [check_number(name, number) for number in value]
    if len(numbers) == 2 and -math.inf < numbers[0] < numbers[1] < math.inf:
        return numbers[0], numbers[1]
    raise ValueError(f"{name} must be two increasing finite numbers, got {value!r}")
