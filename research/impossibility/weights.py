"""Elementary weights by their definition, in any field of numbers, such as polynomials.

This module shares no code with `cg.conditions`, which the tests compare with it.
"""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from math import factorial
from typing import Any

from cg.construction.points import START, PointTree
from cg.construction.trees import forest


def exact_weights(
    tree: PointTree, order: int, indices: Sequence[int], number: Callable[[Fraction], Any]
) -> list[Any]:
    r"""Return ``Φ(t)`` of the result of a step, in any field of numbers.

    This evaluates the definition for each tree and point. With the letters
    :math:`\ell_m(t) = \sum_k \alpha_{m,k} \Phi_k(t)`,

    .. math:: \chi_m(w) = \sum_{w = u v} \chi_{\mathrm{parent}(m)}(u)\,
              \ell_m(v_1) \cdots \ell_m(v_n) / n!.

    `indices` are those of trees with at most ``order + 1`` nodes; `number` converts a Fraction.
    """
    trees = forest(order + 1)
    weights_of = [
        {k: number(weight) for k, weight in point.weights.items()} for point in tree.points
    ]
    used = {m for at in tree.stage_points for m in tree.path(at)}
    inner, last = sorted(used), tree.path(tree.result)
    letters: dict[int, list[Any]] = {}

    def add_letter(t: int, phi: Sequence[Any]) -> None:
        letters[t] = [
            sum((weight * phi[k] for k, weight in row.items() if phi[k] != 0), start=zero)
            for row in weights_of
        ]

    one = number(Fraction(1))
    zero = one * 0
    add_letter(1, [one] * len(tree.stage_points))
    for t in range(2, trees.with_nodes(order).stop):
        ends = word_weights(tree, inner, trees.children[t - 1], letters, one)
        add_letter(t, [ends[at] for at in tree.stage_points])
    return [
        word_weights(tree, last, trees.children[t - 1], letters, one)[tree.result] for t in indices
    ]


def word_weights(
    tree: PointTree,
    points: Sequence[int],
    word: Sequence[int],
    letters: Mapping[int, Sequence[Any]],
    one: Any,
) -> dict[int, Any]:
    """Return the character χ of each point on a word of trees.

    For each prefix of the word, of length ``end``, χ at point m is the sum over shorter prefixes,
    of length ``begin``, of χ at the parent times the remaining n letters at m, divided by n!.
    """
    zero = one * 0
    prefixes = {START: [one] + [zero] * len(word)}  # χ of each prefix, by its length
    for m in points:
        before = prefixes[tree.points[m].parent]
        after = before.copy()
        for end in range(1, len(word) + 1):
            product = one
            for begin in range(end - 1, -1, -1):
                product = product * letters[word[begin]][m]
                if product == 0:
                    break
                after[end] = after[end] + before[begin] * product / factorial(end - begin)
        prefixes[m] = after
    return {m: row[-1] for m, row in prefixes.items()}
