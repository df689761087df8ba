"""The method of the catalogue that has the same coefficients, but for one or two."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from cg.construction.catalogue import methods
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.tableau import Tableau

_MAX_CHANGED = 2
_MIN_ALIKE = 3
_ROUNDING = Fraction(1, 2**51)


@dataclass(frozen=True)
class CatalogueMatch:
    """A method of the catalogue, and the names and both values of up to two other entries."""

    method: Method
    changed: tuple[tuple[str, Coefficient, Coefficient], ...]


def closest_match(method: Method, *, within: Fraction = Fraction(0)) -> CatalogueMatch | None:
    """Return the method of the catalogue with the fewest different coefficients; None if none fits.

    Coefficients agree within their uncertainties or `within`. Two may differ if three others agree.
    """

    def distance(match: CatalogueMatch) -> tuple[int, bool, bool]:
        known = match.method
        other_kind = isinstance(known, MuntheKaas) != isinstance(method, MuntheKaas)
        return len(match.changed), known.layout.pair != method.layout.pair, other_kind

    comparable = (known for known in methods.values() if known.stages == method.stages)
    matches = filter(None, (_compare(method, known, within) for known in comparable))
    return min(matches, key=distance, default=None)


def _compare(method: Method, known: Method, within: Fraction) -> CatalogueMatch | None:
    one, other = _packed(method), _packed(known)
    if one is None or other is None or one[0] != other[0]:
        return None
    names, alike, changed = method.layout.names, 0, []
    # the second weights of a pair come last; the other method may lack them
    for name, x, y in zip(names, one[1], other[1], strict=False):
        # allow for coefficients that were rounded to doubles, but not for longer ones
        double = not x.unit or abs(x.value - Fraction(float(x.value))) <= x.unit
        allowed = max(x.unit + y.unit, abs(y.value) * _ROUNDING * double, within)
        if abs(x.value - y.value) <= allowed:
            alike += y.value != 0
        else:
            changed.append((name, x, y))
        if len(changed) > _MAX_CHANGED:
            return None
    if changed and alike < max(_MIN_ALIKE, 2 * len(changed)):
        return None
    return CatalogueMatch(known, tuple(changed)) if alike else None


def _packed(method: Method) -> tuple[object, Sequence[Coefficient]] | None:
    """Return a key that is equal for methods of the same shape, and the coefficients."""
    if isinstance(method, Tableau | MuntheKaas):
        return method.layout.rows, method.coefficients
    if isinstance(method, CommutatorFree):
        layout = method.layout
        shape = (layout.parents, layout.weights, layout.stage_points, layout.results[0])
        return shape, method.coefficients
    return None
