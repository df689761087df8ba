"""A step of a method, one flow at a time, in numbers of any kind.

This states in the fewest lines what the compiled steps do. Reference steps in ball arithmetic, the
spinning top in quadruple precision and tests of the integrators take their steps by it. Points,
values and weights are whatever `value` and `flow` take and return.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

from cg.construction.methods.paths import MethodPaths

End = tuple[Any, Any]
"""A point, and the argument of the flow that led to it, None at the start of the step."""


def take_paths(
    paths: MethodPaths, y: Any, value: Callable[[int, Any, Any], Any],
    flow: Callable[[Any, Sequence[Any], Any], End], values: Sequence[Any] = (),
) -> tuple[list[End], list[Any]]:  # fmt: skip
    """Return the ends of the paths from y, which comes first, and the values at the stages.

    ``value(k, point, u)`` returns the value at stage k, from 0, at a point to which a flow with the
    argument u led. ``flow(terms, values, point)`` returns the end of one flow and its argument,
    with the stages and weights of the flow. `values` are those of the last iteration, for implicit
    methods; without them each is computed as soon as its point is known.
    """
    values, ends = [*values], [(y, None)]
    for path in (*paths.paths, None):
        while len(values) < len(paths.stages) and paths.stages[len(values)] < len(ends):
            values.append(value(len(values), *ends[paths.stages[len(values)]]))
        if path is not None:
            end: End = (ends[path.origin][0], None)
            for terms in path.flows:
                end = flow(terms, values, end[0])
            ends.append(end)
    return ends, values


def with_weights(paths: MethodPaths, convert: Callable[[Fraction], Any]) -> MethodPaths:
    """Return the paths with converted weights, once for many steps."""
    converted = []
    for path in paths.paths:
        flows = tuple(tuple((k, convert(w)) for k, w in terms) for terms in path.flows)
        converted.append(replace(path, flows=flows))
    return replace(paths, paths=tuple(converted))
