"""Result of a search."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, overload

from ...method.method import Method
from ...method.packed import make_method
from ...runs import Failure, Store
from ...structure.layout import Layout
from ...support import quads
from ...support.parallel import single_threads
from ..solvers.polish import polish_zeros
from ..solvers.system import ConditionSystem
from .records import RandomStart
from .settings import SearchSettings
from .start import start_layout

__all__ = ["SearchResult", "StoredStarts"]


class StoredStarts(Sequence[RandomStart]):
    """The first starts of a run in a store, read from the file on access.

    They take no memory. The file must not be moved.
    """

    def __init__(self, path: str | os.PathLike[str], run: int, starts: int) -> None:
        self._path, self._run, self._starts = os.path.abspath(path), run, starts

    def __len__(self) -> int:
        with Store(self._path, read=True) as store:
            query = "AND number < ?"
            return sum(1 for _ in store.run(self._run).numbers(query, self._starts))

    def __iter__(self) -> Iterator[RandomStart]:
        return self._read("AND number < ? ORDER BY number", self._starts)

    @overload
    def __getitem__(self, index: int) -> RandomStart: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[RandomStart, ...]: ...
    def __getitem__(self, index: int | slice) -> RandomStart | tuple[RandomStart, ...]:
        if isinstance(index, slice):
            return tuple(self)[index]
        size = len(self)
        place = operator.index(index)
        if not -size <= place < size:
            raise IndexError(f"start {place} of {size}")
        query = "AND number < ? ORDER BY number LIMIT 1 OFFSET ?"
        return next(self._read(query, self._starts, place % size))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, StoredStarts | tuple):
            return NotImplemented
        return tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]

    def exact(self) -> Iterator[RandomStart]:
        """Yield the exact starts."""
        return self._read("AND number < ? AND solved ORDER BY number", self._starts)

    def smallest(self) -> RandomStart:
        """Return the start with the smallest residual; of several, the first."""
        query = "AND number < ? ORDER BY largest_residual, number LIMIT 1"
        return next(self._read(query, self._starts))

    def _read(self, condition: str, *values: Any) -> Iterator[RandomStart]:
        with Store(self._path, read=True) as store:
            for record in store.run(self._run).records(condition, *values):
                yield RandomStart.from_record(record)


@dataclass(frozen=True, repr=False)
class SearchResult:
    """All starts of a search, ordered by index.

    Attributes
    ----------
    settings : SearchSettings
    starts : sequence of RandomStart
        A tuple; `StoredStarts`, which read from the file, for a search with a store.
    failures : tuple of Failure
        Starts whose worker died; `starts` doesn't have them.
    """

    settings: SearchSettings
    starts: Sequence[RandomStart]
    failures: tuple[Failure, ...] = ()

    def __repr__(self) -> str:
        settings = self.settings
        exact = sum(1 for _ in self._exact())
        return (
            f"<SearchResult: order {settings.order}, {settings.stages} stages, seed "
            f"{settings.seed}: {exact} of {len(self.starts)} starts exact>"
        )

    @cached_property
    def methods(self) -> tuple[Method, ...]:
        """The distinct exact methods, sorted by their largest coefficient.

        Tableaux, or `cg.CommutatorFree` methods of trees. Coefficients have 36 digits, corrected
        in rational arithmetic beyond the accuracy of real(16).
        """
        methods: list[tuple[float, Method]] = []
        seen: set[tuple[Layout, tuple[float, ...]]] = set()
        for start in self._exact():
            key = tuple(round(float(entry), 8) for entry in start.x)
            layout = start_layout(self.settings, start.index)
            if (layout, key) not in seen:
                seen.add((layout, key))
                methods.append((max(map(abs, key)), self._method(start, layout)))
        return tuple(method for _, method in sorted(methods, key=operator.itemgetter(0)))

    @property
    def best(self) -> RandomStart:
        """The start with the smallest residual, whether exact or not."""
        if isinstance(self.starts, StoredStarts):
            return self.starts.smallest()
        return min(self.starts, key=operator.attrgetter("largest_residual"))

    def _exact(self) -> Iterable[RandomStart]:
        if isinstance(self.starts, StoredStarts):
            return self.starts.exact()
        return (start for start in self.starts if start.exact)

    @single_threads()
    def _method(self, start: RandomStart, layout: Layout) -> Method:
        settings = self.settings
        size = f"{settings.stages} stages"
        if layout.rows is None:
            size += f", {len(layout.parents)} flows"
        name = f"order {settings.order}, {size}, start {start.index}"
        source = f"search, {settings.algorithm}, seed {settings.seed}, start {start.index}"
        # the last of the 36 digits are beyond the accuracy of real(16)
        system = ConditionSystem(settings.order, layout)
        x = polish_zeros(list(map(Fraction, start.x)), system, system.free).x
        return make_method(layout, list(map(quads.to_decimal, x)), name=name, source=source)
