"""Requirements on the methods of a search, and the quantity to minimise along solution sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.construction.conditions import MAX_ORDER
from cg.construction.layouts import Layout
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import to_floats
from cg.construction.points import MethodError
from cg.construction.search.candidate import Candidate, NotExactError, to_method
from cg.construction.search.optimise import Limits, optimise
from cg.construction.search.settings import refuse
from cg.construction.solvers.held import plain_name
from cg.support.checks import check_choice, check_interval, check_real

OBJECTIVES = ("principal_error", "largest_coefficient")

_MARGIN = 0.01  # by which penalties start before the bounds, relative
_BOUND_ROUNDING = 1e-9  # largest error of abscissae and coefficients that are at their bounds
_ALL = "coefficients"  # the group of all coefficients

Bounds = tuple[tuple[str, float, float], ...]
"""Names of coefficients, abscissae, or groups of them, and the intervals they must lie in."""


@dataclass(frozen=True)
class Requirements:
    """Bounds that the methods of a search satisfy, and the objective; see `cg.search`."""

    bounds: Bounds = ()
    minimise: str | None = None

    @classmethod
    def checked(
        cls, order: int, abscissae: Any = None, bound: Any = None, minimise: Any = None,
        nonnegative: Any = (),
    ) -> Requirements:  # fmt: skip
        """Return the requirements of the arguments of `cg.search`, after checking them."""
        bounds = [] if abscissae is None else [("c", *check_interval("abscissae", abscissae))]
        if isinstance(bound, Mapping):
            bounds += [_named(name, interval) for name, interval in bound.items()]
        elif bound is not None:
            size = check_real("bound", bound, positive=True)
            bounds.append((_ALL, -size, size))
        names = (nonnegative,) if isinstance(nonnegative, str) else nonnegative
        if not isinstance(names, tuple | list):
            raise TypeError(f"nonnegative must be names such as 'b', got {nonnegative!r}")
        bounds += [(plain_name("nonnegative", name), 0.0, np.inf) for name in names]
        if minimise is not None:
            check_choice("minimise", minimise, OBJECTIVES)
        if minimise == "principal_error" and order >= MAX_ORDER:
            raise ValueError(f"minimise: order must be below {MAX_ORDER}, got {order}")
        return cls(tuple(bounds), minimise)

    def check(self, order: int, layout: Layout | None, force: bool) -> None:
        """Raise ValueError if a layout has no such names, or if no method satisfies the bounds.

        If trees are drawn, without a layout, only groups have names.
        """
        if layout is not None:
            self.limits(layout)
        elif unknown := {name for name, _, _ in self.bounds} - {_ALL, "c", "w"}:
            raise ValueError(
                f"bound, nonnegative must name c or w of drawn trees, got {min(unknown)}"
            )
        positive = {name for name, lower, _ in self.bounds if lower >= 0}
        if order >= 3 and positive & {_ALL, "b", "w"}:
            refuse(
                force,
                f"nonnegative: no method of order {order} has weights of its result that are all "
                ">= 0: see the page 'Methods that do not exist' of the documentation",
            )

    def __str__(self) -> str:
        texts = [f"{name} in [{lower:g}, {upper:g}]" for name, lower, upper in self.bounds]
        texts += [f"a small {self.minimise.replace('_', ' ')}"] if self.minimise else []
        return " and ".join(texts)

    def limits(self, layout: Layout, margin: float = 0.0) -> Limits:
        """Return the bounds on the unknowns of a layout, moved inside by a relative margin."""
        rows, lower, upper = [], [], []
        sums = {name: [k] for k, name in enumerate(layout.names)}
        sums |= {f"c_{stage + 1}": layout.row(stage) for stage in range(layout.stages)}
        for name, low, high in self.bounds:
            named = [
                row for key, row in sums.items()
                if name in (key, key.rpartition("_")[0]) or (name == _ALL and key[:2] != "c_")
            ]  # fmt: skip
            if not named:
                raise ValueError(
                    f"bound, nonnegative must name one of {', '.join(sums)}, got {name}"
                )
            inside = margin * min((high - low) / 2, max(1.0, abs(low)), max(1.0, abs(high)))
            for row in named:
                rows.append(np.isin(np.arange(layout.size), row).astype(float))
                lower.append(low + inside)
                upper.append(high - inside)
        return Limits(np.reshape(rows, (-1, layout.size)), np.array(lower), np.array(upper))

    def satisfied(self, candidate: Candidate) -> bool:
        """Return whether a candidate is within the bounds."""
        beyond, _ = self.limits(candidate.system.layout).beyond(candidate.x)
        return bool((np.abs(beyond) <= _BOUND_ROUNDING).all())

    def improve(self, candidate: Candidate) -> Candidate | None:
        """Return a candidate that satisfies the requirements, None if none was reached."""
        if self.minimise or not self.satisfied(candidate):
            candidate = optimise(
                candidate,
                principal_error=float(self.minimise == "principal_error"),
                coefficients=float(self.minimise == "largest_coefficient"),
                limits=self.limits(candidate.system.layout, _MARGIN),
            )
        return candidate if self.satisfied(candidate) else None

    def method(self, candidate: Candidate, *, name: str, source: str) -> Method | None:
        """Return the refined method of a candidate that satisfies the requirements, or None."""
        improved = self.improve(candidate)
        if improved is None or improved.estimate_vanishes:
            return None
        source += ", then along the solution set" * (improved is not candidate)
        try:
            return to_method(improved, name=name, source=source)
        except (NotExactError, MethodError):  # the latter if both results of a pair agree
            return None

    def key(self, method: Method) -> float:
        """Return the number by which methods are sorted."""
        if self.minimise == "principal_error":
            return method.principal_error
        return round(float(np.abs(to_floats(method.coefficients)).max()), 8)


def _named(name: Any, interval: Any) -> tuple[str, float, float]:
    """Return a name and the ends of its interval, infinite where they are None."""
    name = plain_name("bound", name)
    unbounded = np.finfo(float).max
    try:
        ends = zip(interval, (-unbounded, unbounded), strict=True)
        lower, upper = check_interval("ends", [x if end is None else end for end, x in ends])
    except (TypeError, ValueError):
        raise ValueError(
            f"bound: {name} must have two increasing ends, finite numbers or None, got {interval!r}"
        ) from None
    return name, lower if lower > -unbounded else -np.inf, upper if upper < unbounded else np.inf
