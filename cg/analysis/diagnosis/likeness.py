"""Which method of the catalogue a method is, or is all but a coefficient or two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

from ...catalogue import methods, munthe_kaas
from ...method.coefficients import Coefficient
from ...method.commutator_free import CommutatorFree
from ...method.method import Method
from ...method.munthe_kaas import MuntheKaas
from ...method.tableau import Tableau

__all__ = ["Likeness", "likeness"]

_MAX_CHANGED = 2
_MIN_ALIKE = 3
_ROUNDING = Fraction(1, 2**51)


@dataclass(frozen=True)
class Likeness:
    """A method of the catalogue that has the same coefficients, or nearly so.

    Attributes
    ----------
    method : Method
        Of the catalogue.
    changed : tuple of (str, Coefficient, Coefficient)
        Names of coefficients that differ, what they are here and there.
    """

    method: Method
    changed: tuple[tuple[str, Coefficient, Coefficient], ...]


def likeness(method: Method, *, within: Fraction = Fraction(0)) -> Likeness | None:
    """Return the method of the catalogue that is most like this one; None if none is.

    Coefficients are the same if they differ by no more than they may both be off, or by `within`.
    Up to two may differ, as long as at least three others that aren't zero agree.

    Parameters
    ----------
    method : Method
    within : Fraction, optional
    """
    compared = (_compare(method, known, within) for known in _comparable(method))
    found = [like for like in compared if like is not None]

    def distance(like: Likeness) -> tuple[int, bool]:
        return len(like.changed), like.method.layout.pair != method.layout.pair

    return min(found, key=distance, default=None)


def _comparable(method: Method) -> Iterator[Method]:
    catalogues = (
        (munthe_kaas, methods) if isinstance(method, MuntheKaas) else (methods, munthe_kaas)
    )
    for catalogue in catalogues:
        for known in catalogue.values():
            if known.stages == method.stages:
                yield known


def _compare(method: Method, known: Method, within: Fraction) -> Likeness | None:
    one, other = _packed(method), _packed(known)
    if one is None or other is None or one[0] != other[0]:
        return None
    names, alike, changed = method.layout.names, 0, []
    # pairs have second weights at the end, which the other may lack
    for name, x, y in zip(names, one[1], other[1], strict=False):
        # what went through a double or two is the same
        allowed = max(x.unit + y.unit, abs(y.value) * _ROUNDING, within)
        if abs(x.value - y.value) <= allowed:
            alike += y.value != 0
        else:
            changed.append((name, x, y))
        if len(changed) > _MAX_CHANGED:
            return None
    if changed and alike < max(_MIN_ALIKE, 2 * len(changed)):
        return None
    return Likeness(known, tuple(changed)) if alike else None


def _packed(method: Method) -> tuple[object, Sequence[Coefficient]] | None:
    """Return a shape, which only methods of one kind have in common, and the coefficients."""
    if isinstance(method, Tableau | MuntheKaas):
        return method.layout.rows, method.coefficients
    if isinstance(method, CommutatorFree):
        layout = method.layout
        shape = (layout.parents, layout.weights, layout.stage_points, layout.results[0])
        return shape, method.coefficients
    return None
