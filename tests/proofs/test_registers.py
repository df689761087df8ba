"""Methods of two registers: the identity of docs/mathematics/two_registers.md proves all others."""

from fractions import Fraction

import numpy as np
import pytest
from exact import word_residuals

from cg.construction.conditions import condition_trees, residuals
from cg.construction.conditions import exact as ws
from cg.construction.methods.low_storage import from_two_registers
from cg.construction.proofs.dependent.orthogonality import Reduction
from cg.construction.trees import forest, rooted_trees

pytestmark = pytest.mark.sanitize


def exchange(p, v, w, q):
    """Return Σ (p ⧢ v) w q - Σ (p ⧢ w) v q - p [v ⧢ w] q + p [w ⧢ v] q, zero for two registers."""
    relation = {}
    for first, second, sign in ((v, w, 1), (w, v, -1)):
        for word, m in ws.shuffle(p, (first,)).items():
            ws.add_multiple(relation, (*word, second, *q), sign * m)
        for letter, m in ws.shuffle(second, (first,)).items():
            ws.add_multiple(relation, (*p, letter, *q), -sign * m)
    return {word: m for word, m in relation.items() if m}


def exchanges(count):
    """Return the combinations of words with this number of nodes, at the root or deeper."""
    relations = []
    for size in range(2, count + 1):
        for first in range(1, size):
            for left in range(count - size + 1):
                relations += [
                    relation
                    for v in ws.words_with(first - 1)
                    for w in ws.words_with(size - first - 1)
                    for p in ws.words_with(left)
                    for q in ws.words_with(count - size - left)
                    if (relation := exchange(p, v, w, q))
                ]
    for inside in range(2, count):
        for left in range(count - inside):
            relations += [
                {(*p, letter, *q): m for letter, m in relation.items()}
                for relation in exchanges(inside)
                for p in ws.words_with(left)
                for q in ws.words_with(count - 1 - inside - left)
            ]
    return relations


def flat(tree):
    """Return a rooted tree as a combination of ordered ones."""
    words = {(): 1}
    for child in tree:
        words = ws.extend(lambda word, child=child: shuffled(word, child), words)
    return words


def shuffled(word, child):
    return ws.extend(lambda letter: ws.shuffle(word, (letter,)), flat(child))


@pytest.mark.parametrize("seed", [1, 2])
def test_relations_hold_for_any_coefficients_of_two_registers(seed):
    generator = np.random.default_rng(seed)
    a, b = ([f"{int(x)}/64" for x in generator.integers(-90, 90, 5)] for _ in range(2))
    method = from_two_registers(["0", *a[1:]], b)
    x = [coefficient.value for coefficient in method.coefficients]
    words = list(ws.condition_words(5, independent=False))
    residuals = dict(zip(words, word_residuals(method.layout, x, words), strict=True))
    assert all(residuals[word] for word in words[:3])
    relations = [one for count in range(2, 6) for one in exchanges(count)]
    assert len(relations) > 30
    for relation in relations:
        assert sum(c * residuals[word] for word, c in relation.items()) == 0


@pytest.mark.parametrize("order", [3, 4, 5, 6])
def test_flat_conditions_imply_all_others(order):
    """With the relations, the conditions of rooted trees determine all residuals of this order."""
    conditions = [w for w in ws.condition_words(order) if ws.nodes(w) == order]
    # those of fewer nodes being satisfied, products vanish
    reduction = Reduction(Fraction, lambda _: Fraction(0))
    trees = ({(letter,): m for letter, m in flat(tree).items()} for tree in rooted_trees(order))
    rows = [
        [float(reduction.total(one.items()).get(w, 0)) for w in conditions]
        for one in (*trees, *exchanges(order))
    ]
    assert np.linalg.matrix_rank(rows) == len(conditions)


def test_antisymmetry_carries_over_from_flat_space():
    """A step forth and one back are a two-register method again, with weights of the identity."""
    a = [Fraction(0), Fraction(-7, 15), Fraction(-35, 32)]
    b = [Fraction(1, 3), Fraction(15, 16), Fraction(2, 5)]
    both = from_two_registers(a + a, b + [-step for step in b])
    numbers, trees = condition_trees(6), forest(7)
    errors = residuals(both, 6, arithmetic="exact")
    weights = {
        k: error + Fraction(1, trees.tree(k).density)
        for k, error in zip(numbers, errors, strict=True)
    }
    not_zero = {k for k, weight in weights.items() if weight}
    assert not_zero
    assert not_zero <= set(trees.with_nodes(7))
