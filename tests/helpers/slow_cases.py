"""Cases of tests of which `make test` runs some, and `make test-all` all."""

from collections.abc import Callable, Iterable
from itertools import product
from typing import Any

import pytest


def slow(*cases: Any) -> list[Any]:
    """Return cases, each a value or a tuple of values, marked as slow."""
    tuples = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*case, marks=pytest.mark.slow) for case in tuples]


def cases(*values: Iterable[Any], quick: Callable[..., bool]) -> list[Any]:
    """Return all combinations of values, those marked as slow for which ``quick`` is False."""
    combinations = list(product(*values))
    return [
        *(case for case in combinations if quick(*case)),
        *slow(*(case for case in combinations if not quick(*case))),
    ]
