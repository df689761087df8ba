"""Order conditions as equations of SymPy, which writes them as LaTeX too."""

from __future__ import annotations

from typing import Any

from cg.construction.conditions.counts import check_order
from cg.construction.conditions.word_weights import Quantity, Weights
from cg.construction.conditions.words import condition_words, reciprocal_density
from cg.construction.layouts.layout import Layout, Rows
from cg.support.checks import check_flag, check_integer


def equations(method: Any, order: int, independent: bool = True, form: str = "sums") -> list[Any]:
    """Return order conditions as equations of SymPy, in unknown coefficients.

    Parameters
    ----------
    method
        The number of stages of an explicit tableau, at most 100, or a method, of which only the
        pattern of coefficients is used.
    order
        Conditions through this order.
    independent
        Whether conditions that others imply are left out.
    form
        ``"sums"`` keeps products of sums, as the conditions are computed; ``"expanded"`` multiplies
        them out, which takes minutes for order five with nine stages.

    Returns
    -------
    list of sympy.Eq
        ``Φ(t) = 1/γ(t)``, in the sequence of `cg.conditions.residuals`. The symbols are those of
        `cg.diagnose`, counted from 1: ``a_2,1`` and ``b_2`` of a tableau, ``w_3,1`` of point 3
        and stage 1 of other methods. ``sympy.latex`` writes them for a paper.

    Raises
    ------
    ModuleNotFoundError
        Without SymPy.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.conditions.equations(2, order=2)
    [Eq(b_1 + b_2, 1), Eq(a_2,1*b_2, 1/2)]
    """
    import sympy

    if form not in ("sums", "expanded"):
        raise ValueError(f'form must be "sums" or "expanded", got {form!r}')
    if isinstance(method, int) and not isinstance(method, bool):
        layout: Any = Layout.tableau(check_integer("method", method, 1, 100), Rows.EXPLICIT)
    else:
        layout = getattr(method, "layout", None)
    # methods of Munthe-Kaas, with a tableau, and splitting methods, with drifts, have others
    others = hasattr(method, "tableau") or hasattr(method, "drifts")
    if not isinstance(layout, Layout) or layout.of_time or others:
        kinds = "a Crouch-Grossman or a commutator-free method"
        raise TypeError(f"method must be a number of stages, {kinds}, got {method!r}")
    words = condition_words(check_order(order, None), check_flag("independent", independent))
    weights = Weights(layout, [Quantity(layout.stages, word) for word in words])
    values = weights.evaluate([sympy.Symbol(name) for name in layout.names])
    sides = [sympy.Rational(str(reciprocal_density(word))) for word in words]
    if form == "expanded":
        values = [sympy.expand(value) for value in values]
    pairs = zip(values, sides, strict=True)
    return [sympy.Eq(value, side, evaluate=False) for value, side in pairs]
