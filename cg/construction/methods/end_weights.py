r"""Error estimates that see jumps after the last node of a step, and kinks within a step.

The difference of the two results of a pair without a node at the end of the step doesn't change if
the field jumps after its last node. A combination :math:`h \sum_k d_k F_k` of the values at stages
and of the value at the result, which is that at the start of the next step, does. The weights d are
such that it vanishes through as high a power of h as the difference of the results does, or one
below it. In the latter case the quotient of its square and of a combination that is one order lower
has the order of the difference.

The estimate of DOP853 is the square of a difference of results of order five, divided by one of
order three. It is almost blind to kinks of the field near the five times at which the former
vanishes. A combination of the values at stages that vanishes through one power of h more is zero
at other times, and on smooth fields it is smaller, so that the larger of both is taken there.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions.exact import Quantity, Weights, condition_words
from cg.construction.layouts import Layout
from cg.construction.methods.classical_conditions import stage_weights
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.points import PointTree
from cg.construction.trees import forest
from cg.support.caches import cached_by_identity

Matrix = NDArray[np.float64]

_AT_END = 1e-9  # nodes nearer to the end are at the end
_NO_SIZE = 1e-10  # singular values, and squared weights at the end, that are rounding
_SHARE = Fraction(1, 5)  # estimate of a jump just after the last node, relative to its error
_SIZE = 1 / 3  # sum of magnitudes of `kink_weights`, relative to that of the third weights


@dataclass(frozen=True)
class EndWeights:
    """Combinations of values at stages and at the result, where their weights are 1."""

    rows: tuple[tuple[Fraction, ...], ...]  # one combination or two, that of higher order first
    factor: Fraction  # factor of the estimate: a fifth of the time after the last node


@cached_by_identity
def end_weights(method: Method) -> EndWeights | None:
    """Return the weights for an explicit pair that doesn't see the end of a step, else None."""
    order, second = method.order, method.embedded_order
    tree = method.tree
    result = tree.embedded_result if (second or 0) > order else tree.result
    if second is None or result is None or method.third_order is not None:
        return None
    if isinstance(method, MagnusMethod | MuntheKaas) or not method.explicit:
        return None
    if method.c.max() > 1.0 - _AT_END:
        return None
    highest = min(order, second)
    values = _values(tree, result, highest)
    rows = [_vanishing(values)]
    if rows[0] is None and highest > 2:
        below = [forest(highest).with_nodes(power).start - 1 for power in (highest, highest - 1)]
        rows = [_vanishing(values[:count]) for count in below]
    weights = tuple(tuple(map(Fraction, row.tolist())) for row in rows if row is not None)
    if len(weights) < len(rows):
        return None
    return EndWeights(weights, _SHARE * Fraction(1.0 - method.c.max()))


@cached_by_identity
def kink_weights(method: Method) -> tuple[Fraction, ...] | None:
    """Return the weights of stages for kinks in a pair with two more results, else None.

    They satisfy the conditions for commuting flows as the third result does; the sum of their
    magnitudes is a third of that of the third weights: errors of kinks are at most 34 estimates.
    """
    second, third = method.embedded_order, method.third_order
    if isinstance(method, MagnusMethod) or not method.explicit or second is None or third is None:
        return None
    if not third < second < method.order:
        return None
    words = [(), *condition_words(second, independent=False)]
    basis = _null_space(np.array(list(map(stage_weights(method.a), words))))
    if not len(basis):
        return None
    size = float(sum(map(abs, method.error_weights[-1])))
    return tuple(map(Fraction, (_SIZE * size / abs(basis[-1]).sum() * basis[-1]).tolist()))


def _values(tree: PointTree, result: int, order: int) -> Matrix:
    """Return the elementary weights of trees up to an order at stages and at the result."""
    layout = Layout.of_tree(tree)
    ends = [*range(layout.stages), layout.stages + layout.results.index(result)]
    words = [(), *(condition_words(order - 1, False) if order > 1 else ())]
    weights = Weights(layout, [Quantity(end, word) for word in words for end in ends])
    x = [float(weight) for point in tree.points for weight in point.weights.values()]
    return np.array(weights.evaluate(x)).reshape(len(words), -1)


def _vanishing(values: Matrix) -> NDArray[np.float64] | None:
    """Return the smallest weights on which all rows vanish, with 1 at the end, if there are any."""
    basis = _null_space(values)
    at_end = basis[:, -1]
    square = float(at_end @ at_end)
    return None if square < _NO_SIZE else at_end @ basis / square


def _null_space(values: Matrix) -> Matrix:
    """Return an orthonormal basis of the weights on which all rows vanish."""
    _, sizes, basis = np.linalg.svd(values)
    return basis[np.count_nonzero(sizes > _NO_SIZE * sizes[0]) :]
