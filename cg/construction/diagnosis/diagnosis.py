"""The result of diagnosing a method, and the functions that diagnose one, or a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from fractions import Fraction
from math import isfinite
from os import PathLike
from textwrap import indent
from typing import Any

from cg.construction.catalogue import entries, resolve_method
from cg.construction.conditions import MAX_ORDER, condition_trees, residuals
from cg.construction.diagnosis.correction import Correction, corrections
from cg.construction.drawings import draw_tree
from cg.construction.methods.classical_conditions import failing_rooted, flat_order
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.methods.tableau import Tableau, TableauError
from cg.construction.trees import OrderedTree, forest, planted
from cg.support.parsing import read_file, visible
from cg.support.quads import MissingQuadsError

_HARMLESS = 1e-13  # residuals in double precision
_ALMOST_ZERO = 1e-6  # residuals of a condition that more digits would satisfy


@dataclass(frozen=True)
class FailingCondition:
    """A violated order condition ``Φ(t) = 1/γ(t)``, of an ordered or a planted rooted tree."""

    order: int
    tree: OrderedTree
    residual: float  # Φ(t) - 1/γ(t)
    right_side: Fraction  # 1/γ(t)

    def __str__(self) -> str:
        off = f"{self.residual:.3g}" if self.residual else "less than a double can tell"
        weight = self.residual + float(self.right_side)
        return (
            f"{draw_tree(self.tree)}\n"
            f"{self.tree}  Φ = {weight:.10g}, 1/γ = {self.right_side}, off by {off}"
        )


@dataclass(frozen=True)
class Diagnosis:
    """Order, first violated order condition and mistakes of a method.

    Attributes
    ----------
    method
    order
        Order on manifolds to the precision of the coefficients (`Method.exact_order`).
    flat_order
        Order on vector spaces, where flows commute.
    embedded_order
        Order of the second result of a pair.
    failing
        The first violated order condition; None if all conditions of the tabulated orders hold.
    corrections
        Changes of single coefficients that restore the highest order, on manifolds or on vector
        spaces, with attributes name, given, value, order, flat, embedded and conditions.
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
        order = f"{self.order} on manifolds"
        if self.flat_order != self.order:
            order += f", {self.flat_order} where flows commute"
        name = visible(self.method.name) or "a method"
        lines = [f"{name}: {self.method.description()}", f"order: {order}"]
        if self.failing is not None:
            lines.append(f"first condition of order {self.failing.order} that fails:")
            lines.append(indent(str(self.failing), "    "))
        lines += [f"mistake: {mistake}" for mistake in self.mistakes] or ["no mistake recognised"]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the diagnosis as a dict for JSON."""
        failing = self.failing
        return {
            "name": self.method.name,
            "order": self.order,
            "flat_order": self.flat_order,
            "embedded_order": self.embedded_order,
            "first_failing": failing
            and vars(failing) | {"tree": str(failing.tree), "right_side": str(failing.right_side)},
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
            f"method must be for nonlinear equations, no splitting method, got {method!r}"
        )
    order, flat = method.exact_order, flat_order(_flat_tableau(method))
    changes: tuple[Correction, ...] = ()
    if not method.approximate:
        with suppress(MissingQuadsError):
            changes = corrections(method)
    mistakes = tuple(_mistakes(method, c, order, flat, changes))
    failing = _first_failing(method)
    return Diagnosis(method, order, flat, method.embedded_order, failing, changes, mistakes)


def diagnose_file(path: str | PathLike[str]) -> Diagnosis:
    """Diagnose the method in a file; unlike `cg.load`, accept wrong ``c``."""
    path = entries.check_path(path)
    with entries.errors_naming(path):
        entry = entries.read_entry(read_file(path, TableauError), path.name)
        c = entry.pop("c", None)
        return diagnose(entries.from_entry(entry, path.stem), c=c)


def _mistakes(
    method: Method, c: Sequence[Any] | None, order: int, flat: int, changes: Sequence[Correction]
) -> Iterator[str]:
    if c is not None:
        yield from entries.wrong_abscissae(method, c)
    if method.exact_embedded is not None:
        pairs = zip(method.exact[1], method.exact_embedded, strict=True)
        apart = max(abs(first - second) for first, second in pairs)
        if apart <= _HARMLESS:
            yield (
                f"the second weights equal the first up to {float(apart):.1g}: the difference of "
                "both results is zero up to rounding"
            )
    if method.approximate:
        return
    highest, residual = order, method.max_residual(order) if order else 0.0
    while highest < MAX_ORDER and (more := method.max_residual(highest + 1)) < _ALMOST_ZERO:
        highest, residual = highest + 1, more
    if changes and (changes[0].embedded or changes[0].order >= highest):
        first = changes[0]
        result = f"the order{' of the second result' if first.embedded else ''} be {first.order}"
        where = " where flows commute" if first.flat else ""
        values = " or ".join(f"{one.name} = {one.given} were {one.value}" for one in changes)
        yield (
            f"{first.conditions} violated conditions would hold, and {result}{where}, if only "
            f"{values}"
        )
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


def _flat_tableau(method: Method) -> Tableau:
    """Return the classical tableau to which a method reduces where flows commute."""
    # the uncertainties of weights add up as the weights do
    uncertain = method.layout.tree([weight.unit for weight in method.coefficients])
    values, units = (
        [tree.flat_row(at) for at in (*tree.stage_points, tree.result)]
        for tree in (method.tree, uncertain)
    )
    *a, b = (
        [Coefficient(value, "", unit) for value, unit in zip(*row, strict=True)]
        for row in zip(values, units, strict=True)
    )
    return Tableau(a, b)


def _first_failing(method: Method) -> FailingCondition | None:
    """Return the first violated condition of lowest order; None beyond the highest known order."""
    order = method.exact_order + 1
    if order > MAX_ORDER:
        return None
    if isinstance(method, MuntheKaas):
        tableau = method.tableau
        rooted, weight, side = failing_rooted(tableau.entries, tableau.weights, order)[0]
        return FailingCondition(order, planted(rooted), float(weight - side), side)
    exact = residuals(method.tree, order, independent=True, arithmetic="exact")
    pairs = zip(exact, method.tolerance(order), strict=True)
    # an infinite tolerance of huge coefficients decides nothing, as in `Method.satisfies`
    holds = [isfinite(allowed) and abs(residual) <= allowed for residual, allowed in pairs]
    k = holds.index(False)
    tree = forest(order + 1).tree(condition_trees(order, independent=True)[k])
    return FailingCondition(order, tree, float(exact[k]), Fraction(1, tree.density))
