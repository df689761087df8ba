"""The result of diagnosing a method, and the functions that diagnose one, or a file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import partial
from os import PathLike
from typing import Any

from cg.construction import conditions
from cg.construction.catalogue import resolve_method
from cg.construction.catalogue.entries import (
    check_path,
    errors_naming,
    from_entry,
    read_entry,
    wrong_abscissae,
)
from cg.construction.conditions import MAX_ORDER
from cg.construction.diagnosis.correction import Correction, corrections
from cg.construction.methods.classical_conditions import failing_rooted, flat_order
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.methods.tableau import Tableau, TableauError
from cg.construction.plots import draw_tree
from cg.construction.trees import OrderedTree, forest, planted, rooted_trees
from cg.support.parsing import read_file, visible
from cg.support.quads import MissingQuadsError, to_decimal

_HARMLESS = 1e-13  # residuals in double precision
_ALMOST_ZERO = 1e-6  # residuals of a condition that more digits would satisfy
_MAX_SHOWN = 5  # corrections


@dataclass(frozen=True)
class Diagnosis:
    """Order, first violated order condition and mistakes of a method.

    Attributes
    ----------
    method
    order
        Order on manifolds to the precision of the coefficients (`Method.exact_order`); for a method
        of Munthe-Kaas, the order of its tableau.
    flat_order
        Order on vector spaces, where flows commute.
    embedded_order
        Order of the second result of a pair.
    failing
        The first violated order condition; None if all conditions of the tabulated orders hold.
    corrections
        Changes of single coefficients that restore the highest order, on manifolds or on vector
        spaces: a `Correction` has the attributes name, given, value, order, flat, embedded and
        conditions.
    mistakes
        Sentences.

    Examples
    --------
    The midpoint rule, with the wrong weights:

    >>> import crouch_grossman as cg
    >>> diagnosis = cg.diagnose(cg.Tableau([[], ["1/2"]], ["1/2", "1/2"], name="mine"))
    >>> diagnosis.order, str(diagnosis.failing.tree)
    (1, '[[[]]]')
    """

    method: Method
    order: int
    flat_order: int
    embedded_order: int | None
    failing: FailingCondition | None
    corrections: tuple[Correction, ...]
    mistakes: tuple[str, ...]

    def __str__(self) -> str:
        method = self.method
        counts = ("evaluation", method.stages), ("flow", method.exponentials)
        costs = ", ".join(f"{count} {label}{'s' * (count != 1)}" for label, count in counts)
        kind = "explicit" if method.explicit else "implicit"
        order = f"{self.order} on manifolds"
        if isinstance(method, MuntheKaas):
            order = f"{self.order}, of the tableau in a Lie algebra"
        elif self.flat_order != self.order:
            order += f", {self.flat_order} where flows commute"
        lines = [f"{visible(method.name) or 'a method'}: {kind}, {costs}", f"order: {order}"]
        if self.embedded_order is not None:
            lines.append(f"order of the second result: {self.embedded_order}")
        if method.approximate:
            assert method.nominal_residual is not None
            lines.append(
                f"nominal order: {method.nominal_order}, whose conditions it satisfies up to "
                f"{float(method.nominal_residual.value):.3g} only"
            )
        if self.failing is not None:
            lines += [
                f"conditions of order {self.failing.order} that fail: {self.failing.failing} of "
                f"{self.failing.of}, first",
                *(f"    {line}".rstrip() for line in str(self.failing).splitlines()),
            ]
        lines += [f"mistake: {mistake}" for mistake in self.mistakes] or ["no mistake recognised"]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the diagnosis as a dict for JSON."""
        method = self.method
        return {
            "name": method.name,
            "kind": type(method).__name__,
            "explicit": method.explicit,
            "evaluations": method.stages,
            "flows": method.exponentials,
            "order": self.order,
            "flat_order": self.flat_order,
            "embedded_order": self.embedded_order,
            "nominal_order": method.nominal_order,
            "first_failing": None if self.failing is None else self.failing.as_dict(),
            "corrections": [asdict(change) for change in self.corrections],
            "mistakes": list(self.mistakes),
        }


def diagnose(method: str | Method, *, c: Sequence[Any] | None = None) -> Diagnosis:
    """Determine the order of a method, and the coefficient whose change raises it.

    Parameters
    ----------
    method
        A method, the name of one in the catalogue, or the path of its file.
    c
        Sequence of s numbers. Abscissae to compare the row sums of a with.

    Returns
    -------
    Diagnosis
        Printed, it shows the order, the first violated order condition with its tree, and the
        mistakes recognised: one wrong coefficient, with the value that it should have; too few
        digits; second weights equal to the first; rows that don't sum to c; a classical tableau
        used on manifolds without lifting.

    Examples
    --------
    Heun's method of order three with a misprint, 2/5 in place of 2/3:

    >>> import crouch_grossman as cg
    >>> diagnosis = cg.diagnose(cg.Tableau([[], ["1/3"], [0, "2/5"]], ["1/4", 0, "3/4"]))
    >>> for one in diagnosis.corrections:
    ...     print(one.name, one.given, one.value, one.order, one.flat)
    a_3,2 2/5 2/3 3 True
    >>> print(diagnosis.failing)
    ●
    └── ●
        └── ●
    [[[]]]  Φ = 0.3, 1/γ = 1/2, off by -0.2
    """
    method = resolve_method(method)
    if isinstance(method, MagnusMethod | Splitting):
        raise TypeError(
            "method must be for nonlinear equations, and no splitting method, whose conditions "
            f"`method.residuals` lists, got {method!r}"
        )
    order, flat = method.exact_order, flat_order(_flat_tableau(method))
    changes: tuple[Correction, ...] = ()
    if not method.approximate:
        with suppress(MissingQuadsError):
            changes = corrections(method)
    mistakes = (
        *(() if c is None else wrong_abscissae(method, c)),
        *_equal_weights(method),
        *_wrong_coefficients(method, order, flat, changes),
    )
    failing = first_failing(method)
    return Diagnosis(method, order, flat, method.embedded_order, failing, changes, mistakes)


def diagnose_file(path: str | PathLike[str]) -> Diagnosis:
    """Diagnose the method in a file; unlike `cg.load`, accept wrong ``c``."""
    path = check_path(path)
    with errors_naming(path):
        entry = read_entry(read_file(path, TableauError), path.name)
        c = entry.pop("c", None)
        return diagnose(from_entry(entry, path.stem), c=c)


def _equal_weights(method: Method) -> Iterator[str]:
    second = method.exact_embedded
    if second is None:
        return
    apart = max(abs(x - y) for x, y in zip(method.exact[1], second, strict=True))
    if apart <= Fraction(_HARMLESS):
        yield (
            f"the second weights equal the first up to {float(apart):.1g}: the difference of both "
            "results is zero up to rounding"
        )


def _wrong_coefficients(
    method: Method, order: int, flat: int, changes: Sequence[Correction]
) -> Iterator[str]:
    if method.approximate:
        return
    highest, residual = order, method.max_residual(order) if order else 0.0
    while highest < MAX_ORDER and (more := method.max_residual(highest + 1)) < _ALMOST_ZERO:
        highest, residual = highest + 1, more
    if changes and (changes[0].embedded or changes[0].order >= highest):
        yield _changed(changes)
    elif highest > order or residual > _HARMLESS:
        yield (
            f"the conditions through order {highest} hold up to {residual:.1g} only: the "
            "coefficients have too few digits, or are rounded numbers given as exact fractions"
        )
    elif flat > order:
        yield (
            f"it is a classical method: of order {flat} where flows commute, of order {order} on "
            "manifolds; cg.lift makes a method for manifolds of it, and cg.MuntheKaas uses its "
            "tableau on frames with brackets"
        )


def _changed(changes: Sequence[Correction]) -> str:
    first, more = changes[0], len(changes) - _MAX_SHOWN
    order = f"the order{' of the second result' if first.embedded else ''} be {first.order}"
    where = " where flows commute" if first.flat else ""
    entries = [
        f"{change.name} were exchanged"
        if "," in change.given
        else f"{change.name} = {change.given} were {change.value}"
        for change in changes[:_MAX_SHOWN]
    ]
    others = f", or one of {more} others changed" if more > 0 else ""
    return (
        f"{first.conditions} violated conditions would hold, and {order}{where}, if only "
        f"{' or '.join(entries)}{others}"
    )


def _flat_tableau(method: Method) -> Tableau:
    """Return the classical tableau to which a method reduces where flows commute."""
    if isinstance(method, Tableau):
        return method
    if isinstance(method, MuntheKaas):
        return method.tableau
    units = method.layout.tree([weight.unit for weight in method.coefficients])

    def row(end: int) -> list[Coefficient]:
        rows = zip(method.tree.flat_row(end), units.flat_row(end), strict=True)
        return [Coefficient(value, to_decimal(value), unit) for value, unit in rows]

    return Tableau([row(at) for at in method.tree.stage_points], row(method.tree.result))


@dataclass(frozen=True)
class FailingCondition:
    """A violated order condition ``Φ(t) = 1/γ(t)``, of an ordered or a planted rooted tree."""

    order: int
    tree: OrderedTree
    residual: float  # Φ(t) - 1/γ(t)
    right_side: Fraction  # 1/γ(t)
    failing: int  # number of violated ones
    of: int  # the number of independent conditions of that order

    @property
    def weight(self) -> float:
        """Φ(t)."""
        return self.residual + float(self.right_side)

    def __str__(self) -> str:
        off = f"{self.residual:.3g}" if self.residual else "less than a double can tell"
        return (
            f"{draw_tree(self.tree)}\n"
            f"{self.tree}  Φ = {self.weight:.10g}, 1/γ = {self.right_side}, "
            f"off by {off}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the condition as a dict for JSON."""
        texts = {"tree": str(self.tree), "right_side": str(self.right_side)}
        return vars(self) | texts | {"drawing": draw_tree(self.tree), "weight": self.weight}


def first_failing(method: Method) -> FailingCondition | None:
    """Return the first violated condition of lowest order; None beyond the highest known order."""
    order = method.exact_order + 1
    if order > conditions.MAX_ORDER:
        return None
    if isinstance(method, MuntheKaas):
        violated = failing_rooted(method.tableau.entries, method.tableau.weights, order)
        rooted, weight, side = violated[0]
        number = len(violated), len(rooted_trees(order))
        return FailingCondition(order, planted(rooted), float(weight - side), side, *number)
    lower = conditions.count(order - 1, independent=True) if order > 1 else 0
    trees = conditions.condition_trees(order, independent=True)[lower:]
    sides = conditions.right_sides(order, independent=True)[lower:]
    allowed = method.tolerance(order)[lower:].tolist()
    residuals_in = partial(conditions.residuals, method.tree, order, independent=True)
    for arithmetic in ("balls", "exact"):  # the latter if the balls contain zero
        residuals = residuals_in(arithmetic=arithmetic)[lower:]
        # an infinite tolerance of huge coefficients decides nothing, as in `Method.satisfies`
        failing = [
            k
            for k, (r, t) in enumerate(zip(residuals, allowed, strict=True))
            if not (math.isfinite(t) and (abs(r) <= t or (arithmetic == "balls" and 0 in r)))
        ]
        if failing:
            break
    k = failing[0]
    tree, residual = forest(order + 1).tree(trees[k]), float(residuals[k])
    return FailingCondition(order, tree, residual, sides[k], len(failing), len(trees))
