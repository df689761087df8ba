"""Combinations of parameters of which `make test` runs some, and `make test-all` all."""

from collections.abc import Callable, Iterable
from itertools import product
from typing import Any

import pytest


def cases(*values: Iterable[Any], quick: Callable[..., bool]) -> list[Any]:
    """Return all combinations of parameters, those marked as slow for which ``quick`` is False."""
    return [
        case if quick(*case) else pytest.param(*case, marks=pytest.mark.slow)
        for case in product(*values)
    ]
