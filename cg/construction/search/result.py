"""Result of a search."""

import operator
from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

import numpy as np

from cg.construction.candidate import Candidate, NotExactError, default_name, make_method, to_method
from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import MethodError
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import to_floats
from cg.construction.search.requirements import Requirements
from cg.construction.search.settings import Settings
from cg.construction.search.start import RandomStart, draw_start
from cg.construction.solvers.polish import polish_zeros
from cg.support.parallel import single_threads

_APART = 1e-4  # distance of coefficients of methods that count as distinct after they were moved


@dataclass(frozen=True, repr=False)
class SearchResult:
    """All starts of a search, ordered by index."""

    settings: Settings
    starts: tuple[RandomStart, ...]
    requirements: Requirements = field(default_factory=Requirements)  # on `methods`

    def __repr__(self) -> str:
        settings = self.settings
        required = f", methods required to have {self.requirements}" * bool(str(self.requirements))
        return (
            f"<SearchResult: order {settings.order}, {settings.stages} stages, seed "
            f"{settings.seed}: {self.exact_starts} of {len(self.starts)} starts exact{required}>"
        )

    @property
    def exact_starts(self) -> int:
        """Number of starts that solved the order conditions, whatever else is required."""
        return sum(1 for _ in self._exact())

    @cached_property
    def methods(self) -> tuple[Method, ...]:
        """The distinct exact methods that satisfy the requirements, the best one first.

        Coefficients have 36 digits, corrected in rational arithmetic beyond the accuracy of
        real(16).
        """
        methods: list[tuple[float, Method]] = []
        seen: set[tuple[Layout, tuple[float, ...]]] = set()
        for start in self._exact():
            layout, _ = draw_start(self.settings, start.index)
            key = tuple(round(float(entry), 8) for entry in start.x)
            if (layout, key) in seen:
                continue
            seen.add((layout, key))
            improved = self._improved(start, layout)
            if improved is not None:
                methods.append(improved)
        methods.sort(key=operator.itemgetter(0))
        if self.requirements == Requirements():
            return tuple(method for _, method in methods)
        distinct: list[Method] = []  # starts that moved to one minimum end close to each other
        for _, method in methods:
            x = to_floats(method.coefficients)
            if not any(
                one.layout == method.layout
                and np.abs(to_floats(one.coefficients) - x).max() < _APART
                for one in distinct
            ):
                distinct.append(method)
        return tuple(distinct)

    @property
    def best(self) -> RandomStart:
        """The start with the smallest residual, whether exact or not."""
        return min(self.starts, key=operator.attrgetter("largest_residual"))

    def _exact(self) -> Iterable[RandomStart]:
        return (start for start in self.starts if start.exact)

    @single_threads()
    def _improved(self, start: RandomStart, layout: Layout) -> tuple[float, Method] | None:
        """Return the method of an exact start, after the number by which methods are sorted."""
        settings, requirements = self.settings, self.requirements
        system = settings.system(layout)
        name = default_name(system, settings.seed, start.index)
        source = f"search, {settings.algorithm}, seed {settings.seed}, start {start.index}"
        candidate = Candidate(system, np.array(start.x, dtype=np.float64))
        improved = requirements.improve(candidate)
        if improved is None or improved.blind:
            return None
        if improved is candidate:
            # the last of the 36 digits are beyond the accuracy of real(16)
            x = polish_zeros(list(map(Fraction, start.x)), system, system.movable).x
            method: Method = make_method(layout, system.texts(x), name=name, source=source)
        else:
            source += ", then along the solution set"
            try:
                method = to_method(improved, name=name, source=source)
            except (NotExactError, MethodError):  # the latter if both results of a pair agree
                return None
        return requirements.key(improved), method
